/* The yardstick of the batch engine: the same scene by hand in C, for gcc -O3 -march=native.
 *
 * Two masses and a spring (4 states), Coulomb friction on the first, encoder in counts on the second, the tick law with its
 * two filters, clamp, fractional delay; exact map per 4 kHz sample, one 1 kHz tick = 4 samples. LANES trials side by side,
 * states in registers over a tick; sums of
 * velocity squared, work, its lowest value, ticks until divergence, largest command. The position of the first mass keeps itself, the other position is relative to it, as
 * the engine does it. Positive force pushes to positive x; units SI. State rows: x, v, gap, u of the second mass, law state,
 * held force. Numbers of `struct scene` come from the engine, so that both compute the same motion.
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
    REAL a[4][3], command[4], torque[4], friction[4]; /* per state: columns v, gap, u */
    REAL sample[3], sample_command, sample_torque, sample_friction;
    REAL friction_n, friction_gain, quantum_m, counts_per_m, limit_n, velocity[5], acceleration[5];
};

static inline REAL clamp(REAL value, REAL limit)
{
    REAL below = value < limit ? value : limit;
    return below > -limit ? below : -limit;
}

/* `state`: 11 rows of LANES; `kbm`: 3 rows; `sums`: alive, velocity squared, work, lowest, ticks, force; `out`: 4 rows of
 * interval-mean velocity and one of force, of every tick (keep = 1) or the last. */
void play(REAL *restrict state, const REAL *restrict kbm, REAL *restrict sums, const struct scene *restrict scene,
          const REAL *restrict torque, REAL *restrict out, long ticks, long keep)
{
    const struct scene c = *scene;
    for (long tick = 0; tick < ticks; tick++) {
        const REAL *t = torque + tick * SAMPLES;
        REAL *restrict o = out + tick * keep * (SAMPLES + 1) * LANES;
#pragma GCC ivdep
        for (int l = 0; l < LANES; l++) {
            REAL x[4], held[4], speed[SAMPLES], y = 0, u = state[10 * LANES + l];
            for (int i = 0; i < 4; i++) {
                x[i] = state[i * LANES + l];
                held[i] = c.command[i] * u;
            }
#pragma GCC unroll 4
            for (int j = 0; j < SAMPLES; j++) {
                REAL n[4];
                for (int i = 0; i < 4; i++) {
                    REAL fed = held[i] + c.torque[i] * t[j];
                    n[i] = c.a[i][0] * x[1] + (c.a[i][1] * x[2] + (c.a[i][2] * x[3] + fed));
                }
                REAL free = n[1] * c.friction_gain, f = clamp(free, c.friction_n);
                for (int i = 0; i < 4; i++)
                    n[i] += c.friction[i] * f;
                n[1] = f == free ? 0 : n[1];
                if (j == SAMPLES - 1)
                    y = x[0] + c.sample[0] * x[1] + c.sample[1] * x[2] + c.sample[2] * x[3] + c.sample_command * u
                        + c.sample_torque * t[j] + c.sample_friction * f;
                o[j * LANES + l] = speed[j] = n[0] * 4000;
                x[0] += n[0];
                x[1] = n[1];
                x[2] = n[2];
                x[3] = n[3];
            }
            y = FLOOR(y * c.counts_per_m + (REAL)0.5) * c.quantum_m;
            REAL *s = state + 4 * LANES + l;
            REAL d = y - s[0], dd = d - s[LANES];
            REAL v = c.velocity[0] * d + s[2 * LANES], a = c.acceleration[0] * dd + s[4 * LANES];
            s[2 * LANES] = c.velocity[1] * d - c.velocity[3] * v + s[3 * LANES];
            s[3 * LANES] = c.velocity[2] * d - c.velocity[4] * v;
            s[4 * LANES] = c.acceleration[1] * dd - c.acceleration[3] * a + s[5 * LANES];
            s[5 * LANES] = c.acceleration[2] * dd - c.acceleration[4] * a;
            s[0] = y;
            s[LANES] = d;
            REAL force = clamp(-(kbm[l] * y + kbm[LANES + l] * v + kbm[2 * LANES + l] * a), c.limit_n);
            state[10 * LANES + l] = force;
            o[SAMPLES * LANES + l] = force;
            for (int i = 0; i < 4; i++)
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
