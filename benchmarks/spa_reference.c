/* The yardstick in C: detrend and `spa` of one record with FFTW, streaming, one thread, in double or float (REAL).
 *
 * Removes linear trends in two passes. Sections of `lag` samples are padded to twice that, with one real transform each
 * (Rader 1970). Then four complex sums, one inverse transform per covariance, Hann lag window, three transforms to the
 * spectra. Plans are made once. `spa_shared` serves many trials under one force: `spa_force` transforms the force's
 * sections once. Each caller has its own buffers, so that threads may run in parallel.
 */
#include <fftw3.h>
#include <math.h>
#include <string.h>

#ifndef REAL
#define REAL double
#define FFTW(name) fftw_##name
#endif

typedef FFTW(complex) complex_t;
static long lag;
static FFTW(plan) forward, backward;
static __thread REAL *padded, *kept, *sums, *v0, *v1, *f0, *f1;

static void make_room(void)
{
    size_t bins = lag + 1;
    if (padded)
        return;
    padded = FFTW(malloc)(4 * lag * sizeof(REAL));
    kept = padded + 2 * lag;
    sums = FFTW(malloc)(4 * 2 * bins * sizeof(REAL));
    v0 = FFTW(malloc)(4 * 2 * bins * sizeof(REAL));
    v1 = v0 + 2 * bins, f0 = v1 + 2 * bins, f1 = f0 + 2 * bins;
}

int spa_prepare(long wanted)
{
    lag = wanted;
    make_room();
    forward = FFTW(plan_dft_r2c_1d)(2 * lag, padded, (complex_t *)v0, FFTW_PATIENT | FFTW_UNALIGNED);
    backward = FFTW(plan_dft_c2r_1d)(2 * lag, (complex_t *)v0, padded, FFTW_PATIENT | FFTW_UNALIGNED);
    return forward && backward;
}

static void line(const REAL *x, long n, double *value, double *slope)
{
    double middle = 0.5 * (n - 1), total = 0, moment = 0;
    for (long i = 0; i < n; i++)
        total += x[i], moment += (i - middle) * x[i];
    *slope = moment / (n * ((double)n * n - 1.0) / 12.0);
    *value = total / n - *slope * middle;
}

static void section(const REAL *x, long start, long n, double value, double slope, REAL *out)
{
    long left = n - start, count = left < 0 ? 0 : left < lag ? left : lag;
    for (long i = 0; i < count; i++)
        padded[i] = x[start + i] - (value + slope * (start + i));
    memset(padded + count, 0, (2 * lag - count) * sizeof(REAL));
    FFTW(execute_dft_r2c)(forward, padded, (complex_t *)out);
}

static void accumulate(int shared)
{
    REAL *restrict uu = sums, *restrict uy = uu + 2 * (lag + 1), *restrict yu = uy + 2 * (lag + 1), *restrict yy = yu + 2 * (lag + 1);
    for (long k = 0; k <= lag; k++) {
        REAL sign = k & 1 ? -1 : 1, a = v0[2 * k], b = v0[2 * k + 1], c = f0[2 * k], d = f0[2 * k + 1];
        REAL p = a + sign * v1[2 * k], q = b + sign * v1[2 * k + 1], r = c + sign * f1[2 * k], s = d + sign * f1[2 * k + 1];
        uu[2 * k] += a * p + b * q, uu[2 * k + 1] += a * q - b * p;
        uy[2 * k] += a * r + b * s, uy[2 * k + 1] += a * s - b * r;
        yu[2 * k] += c * p + d * q, yu[2 * k + 1] += c * q - d * p;
        if (!shared)
            yy[2 * k] += c * r + d * s, yy[2 * k + 1] += c * s - d * r;
    }
}

/* Windowed covariances (lags 0..lag of `ahead`, mirrored `behind`) to a spectrum of lag + 1 complex values. */
static void spectrum(const REAL *ahead, const REAL *behind, long n, REAL *out)
{
    for (int side = 0; side < 2; side++) {
        memcpy(v0, side ? behind : ahead, 2 * (lag + 1) * sizeof(REAL));
        FFTW(execute_dft_c2r)(backward, (complex_t *)v0, padded);
        for (long t = 0; t < lag; t++) {
            REAL w = 0.5 * (1.0 + cos(M_PI * t / lag)) / (2.0 * lag * n) * padded[t];
            if (!side)
                kept[t] = w;
            else if (t)
                kept[2 * lag - t] = w;
        }
    }
    kept[lag] = 0;
    memcpy(padded, kept, 2 * lag * sizeof(REAL));
    FFTW(execute_dft_r2c)(forward, padded, (complex_t *)out);
}

static void exchange(REAL **a, REAL **b)
{
    REAL *was = *a;
    *a = *b;
    *b = was;
}

/* `out`: Phi_u, Phi_y, Phi_yu, each lag + 1 complex values. */
void spa_reference(const REAL *force, const REAL *velocity, long n, REAL *out)
{
    double force_value, force_slope, velocity_value, velocity_slope;
    long size = 2 * (lag + 1);
    make_room();
    line(force, n, &force_value, &force_slope);
    line(velocity, n, &velocity_value, &velocity_slope);
    memset(sums, 0, 4 * size * sizeof(REAL));
    section(velocity, 0, n, velocity_value, velocity_slope, v0);
    section(force, 0, n, force_value, force_slope, f0);
    for (long start = lag; start < n + lag; start += lag) {
        section(velocity, start, n, velocity_value, velocity_slope, v1);
        section(force, start, n, force_value, force_slope, f1);
        accumulate(0);
        exchange(&v0, &v1);
        exchange(&f0, &f1);
    }
    spectrum(sums, sums, n, out);
    spectrum(sums + 3 * size, sums + 3 * size, n, out + size);
    spectrum(sums + size, sums + 2 * size, n, out + 2 * size);
}

/* Transforms of all sections of `force`, zero-padded at the end, each lag + 1 complex values, into `table`. */
void spa_force(const REAL *force, long n, REAL *table)
{
    double value, slope;
    make_room();
    line(force, n, &value, &slope);
    for (long start = 0; start < n + lag; start += lag)
        section(force, start, n, value, slope, table + 2 * (lag + 1) * (start / lag));
}

/* `out`: Phi_u and Phi_yu of a trial under the force whose sections are in `table`. */
void spa_shared(const REAL *table, const REAL *velocity, long n, REAL *out)
{
    double value, slope;
    long size = 2 * (lag + 1);
    make_room();
    REAL *first = f0, *second = f1;
    line(velocity, n, &value, &slope);
    memset(sums, 0, 3 * size * sizeof(REAL));
    section(velocity, 0, n, value, slope, v0);
    for (long start = lag; start < n + lag; start += lag) {
        f0 = (REAL *)table + size * (start / lag - 1), f1 = f0 + size;
        section(velocity, start, n, value, slope, v1);
        accumulate(1);
        exchange(&v0, &v1);
    }
    f0 = first, f1 = second;
    spectrum(sums, sums, n, out);
    spectrum(sums + size, sums + 2 * size, n, out + size);
}
