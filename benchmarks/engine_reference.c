/* The yardstick of the batch engine: the same scene by hand in C, for gcc -O3 -march=native.
 *
 * Bodies, spring and circuits (STATES, the first two are position and velocity of the first body), Coulomb friction on
 * it, encoder in counts, the tick law with its two filters, clamp, force in counts, fractional delay. An exact map per
 * sub-step, SUBSTEPS to a 4 kHz sample, one 1 kHz tick = 4 samples. The terms of a sum are compile-time constants
 * (FEEDS and so on), as in the engine's kernel. LANES trials run in parallel, with states in registers over a tick;
 * sums of velocity squared, work, its lowest value, ticks until divergence, largest command. The position of the first
 * body is integrated; others (APART) are relative to it. A body at rest that sticks keeps its position. Positive force
 * pushes to positive x; units SI. State rows: the states, the law's, the held force. Numbers of `struct scene` come
 * from the engine, so that both compute the same motion.
 */
#include <math.h>

#ifndef REAL
#define REAL float
#endif
#ifndef LANES
#define LANES 32
#endif
#define SAMPLES 4
#define FLOOR(x) (sizeof(REAL) == 4 ? floorf(x) : floor(x))

struct scene {
    REAL a[STATES][STATES], command[STATES], torque[STATES], friction[STATES], sample[STATES];
    REAL sample_command, sample_torque, sample_friction, friction_m_per_s;
    REAL quantum_m, counts_per_m, quantum_n, counts_per_n, limit_n, velocity[5], acceleration[5];
};

static const int feeds[STATES] = FEEDS, pushed[STATES] = PUSHED, rubbed[STATES] = RUBBED, seen[STATES] = SEEN;
static const int apart[STATES] = APART;

static inline REAL clamp(REAL value, REAL limit)
{
    REAL below = value < limit ? value : limit;
    return below > -limit ? below : -limit;
}

/* `state`: STATES + 7 rows of LANES; `kbm`: 3 rows; `sums`: alive, velocity squared, work, lowest, ticks, force; `out`: 4
 * rows of interval-mean velocity and one of force, of every tick (keep = 1) or the last. */
void play(REAL *restrict state, const REAL *restrict kbm, REAL *restrict sums, const struct scene *restrict scene,
          const REAL *restrict torque, REAL *restrict out, long ticks, long keep)
{
    const struct scene c = *scene;
    for (long tick = 0; tick < ticks; tick++) {
        const REAL *t = torque + tick * SAMPLES;
        REAL *restrict o = out + tick * keep * (SAMPLES + 1) * LANES;
#pragma GCC ivdep
        for (int l = 0; l < LANES; l++) {
            REAL x[STATES], held[STATES], fed[STATES] = {0}, speed[SAMPLES] = {0}, y = 0, u = state[(STATES + 6) * LANES + l];
#pragma GCC unroll 8
            for (int i = 0; i < STATES; i++) {
                x[i] = state[i * LANES + l];
                held[i] = c.command[i] * u;
            }
#pragma GCC unroll 4
            for (int j = 0; j < SAMPLES; j++) {
#pragma GCC unroll 8
                for (int i = 0; i < STATES; i++)
                    fed[i] = pushed[i] ? held[i] + c.torque[i] * t[j] : held[i];
#pragma GCC unroll 4
                for (int m = 0; m < SUBSTEPS; m++) {
                    REAL n[STATES];
                    int sampled = j * SUBSTEPS + m == SAMPLE_AT;
#pragma GCC unroll 8
                    for (int i = 0; i < STATES; i++)
                        y += sampled && seen[i] ? (i && SAMPLE_INSIDE ? c.sample[i] : 1) * x[i] : 0;
#pragma GCC unroll 8
                    for (int i = 0; i < STATES; i++) {
                        n[i] = fed[i];
#pragma GCC unroll 8
                        for (int k = STATES - 1; k > 0; k--)
                            n[i] += feeds[i] >> k & 1 ? c.a[i][k] * x[k] : 0;
                    }
                    REAL free = n[1], taken = clamp(free, c.friction_m_per_s);
#pragma GCC unroll 8
                    for (int i = 0; i < STATES; i++)
                        n[i] += rubbed[i] && i != 1 ? c.friction[i] * taken : 0;
                    n[1] = free - taken;
                    REAL stood = taken == free ? x[1] : 1, crept = stood == 0 ? n[0] : 0;
                    n[0] -= crept;
#pragma GCC unroll 8
                    for (int i = 0; i < STATES; i++)
                        n[i] += apart[i] ? crept : 0;
                    if (sampled && SAMPLE_INSIDE)
                        y += c.sample_command * u + c.sample_torque * t[j] + c.sample_friction * taken;
                    speed[j] += n[0];
                    x[0] += n[0];
#pragma GCC unroll 8
                    for (int i = 1; i < STATES; i++)
                        x[i] = n[i];
                }
            }
#pragma GCC unroll 4
            for (int j = 0; j < SAMPLES; j++)
                o[j * LANES + l] = speed[j] *= 4000;
            y = FLOOR(y * c.counts_per_m + (REAL)0.5) * c.quantum_m;
            REAL *s = state + STATES * LANES + l;
            REAL d = y - s[0], dd = d - s[LANES];
            REAL v = c.velocity[0] * d + s[2 * LANES], a = c.acceleration[0] * dd + s[4 * LANES];
            s[2 * LANES] = c.velocity[1] * d - c.velocity[3] * v + s[3 * LANES];
            s[3 * LANES] = c.velocity[2] * d - c.velocity[4] * v;
            s[4 * LANES] = c.acceleration[1] * dd - c.acceleration[3] * a + s[5 * LANES];
            s[5 * LANES] = c.acceleration[2] * dd - c.acceleration[4] * a;
            s[0] = y;
            s[LANES] = d;
            REAL force = clamp(-(kbm[l] * y + kbm[LANES + l] * v + kbm[2 * LANES + l] * a), c.limit_n);
            if (FORCE_QUANTUM)
                force = FLOOR(force * c.counts_per_n + (REAL)0.5) * c.quantum_n;
            s[6 * LANES] = force;
            o[SAMPLES * LANES + l] = force;
#pragma GCC unroll 8
            for (int i = 0; i < STATES; i++)
                state[i * LANES + l] = x[i];
            REAL *sum = sums + l, squared = 0, work = 0, alive;
#pragma GCC unroll 4
            for (int j = 0; j < SAMPLES; j++) {
                squared += speed[j] * speed[j];
                work += speed[j] * t[j];
            }
            sum[0] = alive = squared < (REAL)4e6 ? sum[0] : 0;
            sum[LANES] += alive > 0 ? squared : 0;
            work = sum[2 * LANES] += alive > 0 ? work : 0;
            sum[3 * LANES] = work < sum[3 * LANES] ? work : sum[3 * LANES];
            sum[4 * LANES] += alive;
            force = force > 0 ? force : -force;
            force = alive > 0 ? force : 0;
            sum[5 * LANES] = force > sum[5 * LANES] ? force : sum[5 * LANES];
        }
    }
}
