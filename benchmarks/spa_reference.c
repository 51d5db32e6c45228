/* The yardstick in C: detrend and `spa` of one record with FFTW, streaming, one thread.
 *
 * Linear trends out in two passes, sections of `lag` samples padded to twice that, one real transform each (Rader 1970), four
 * complex sums, one inverse transform a covariance, Hann lag window, three transforms to the spectra. Plans are made once.
 */
#include <fftw3.h>
#include <math.h>
#include <string.h>

static long lag;
static double *padded, *sums, *v0, *v1, *f0, *f1;
static fftw_plan forward, backward;

int spa_prepare(long wanted)
{
    lag = wanted;
    size_t bins = lag + 1;
    padded = fftw_malloc(2 * lag * sizeof(double));
    sums = fftw_malloc(4 * 2 * bins * sizeof(double));
    v0 = fftw_malloc(4 * 2 * bins * sizeof(double));
    v1 = v0 + 2 * bins, f0 = v1 + 2 * bins, f1 = f0 + 2 * bins;
    forward = fftw_plan_dft_r2c_1d(2 * lag, padded, (fftw_complex *)v0, FFTW_PATIENT | FFTW_UNALIGNED);
    backward = fftw_plan_dft_c2r_1d(2 * lag, (fftw_complex *)v0, padded, FFTW_PATIENT | FFTW_UNALIGNED);
    return forward && backward;
}

static void line(const double *x, long n, double *value, double *slope)
{
    double middle = 0.5 * (n - 1), total = 0, moment = 0;
    for (long i = 0; i < n; i++)
        total += x[i], moment += (i - middle) * x[i];
    *slope = moment / (n * ((double)n * n - 1.0) / 12.0);
    *value = total / n - *slope * middle;
}

static void section(const double *x, long start, long n, double value, double slope, double *out)
{
    long left = n - start, count = left < 0 ? 0 : left < lag ? left : lag;
    for (long i = 0; i < count; i++)
        padded[i] = x[start + i] - (value + slope * (start + i));
    memset(padded + count, 0, (2 * lag - count) * sizeof(double));
    fftw_execute_dft_r2c(forward, padded, (fftw_complex *)out);
}

static void accumulate(void)
{
    double *restrict uu = sums, *restrict yy = uu + 2 * (lag + 1), *restrict uy = yy + 2 * (lag + 1), *restrict yu = uy + 2 * (lag + 1);
    for (long k = 0; k <= lag; k++) {
        double sign = k & 1 ? -1.0 : 1.0, a = v0[2 * k], b = v0[2 * k + 1], c = f0[2 * k], d = f0[2 * k + 1];
        double p = a + sign * v1[2 * k], q = b + sign * v1[2 * k + 1], r = c + sign * f1[2 * k], s = d + sign * f1[2 * k + 1];
        uu[2 * k] += a * p + b * q, uu[2 * k + 1] += a * q - b * p;
        yy[2 * k] += c * r + d * s, yy[2 * k + 1] += c * s - d * r;
        uy[2 * k] += a * r + b * s, uy[2 * k + 1] += a * s - b * r;
        yu[2 * k] += c * p + d * q, yu[2 * k + 1] += c * q - d * p;
    }
}

/* Windowed covariances (lags 0..lag of `ahead`, mirrored `behind`) to a spectrum of lag + 1 complex values. */
static void spectrum(const double *ahead, const double *behind, long n, double *out)
{
    static double kept[2 * 65536];
    for (int side = 0; side < 2; side++) {
        memcpy(v0, side ? behind : ahead, 2 * (lag + 1) * sizeof(double));
        fftw_execute_dft_c2r(backward, (fftw_complex *)v0, padded);
        for (long t = 0; t < lag; t++) {
            double w = 0.5 * (1.0 + cos(M_PI * t / lag)) / (2.0 * lag * n) * padded[t];
            if (!side)
                kept[t] = w;
            else if (t)
                kept[2 * lag - t] = w;
        }
    }
    kept[lag] = 0.0;
    memcpy(padded, kept, 2 * lag * sizeof(double));
    fftw_execute_dft_r2c(forward, padded, (fftw_complex *)out);
}

/* `out`: Phi_u, Phi_y, Phi_yu, each lag + 1 complex values. */
void spa_reference(const double *force, const double *velocity, long n, double *out)
{
    double force_value, force_slope, velocity_value, velocity_slope, *swap;
    line(force, n, &force_value, &force_slope);
    line(velocity, n, &velocity_value, &velocity_slope);
    memset(sums, 0, 8 * (lag + 1) * sizeof(double));
    section(velocity, 0, n, velocity_value, velocity_slope, v0);
    section(force, 0, n, force_value, force_slope, f0);
    for (long start = lag; start < n + lag; start += lag) {
        section(velocity, start, n, velocity_value, velocity_slope, v1);
        section(force, start, n, force_value, force_slope, f1);
        accumulate();
        swap = v0, v0 = v1, v1 = swap;
        swap = f0, f0 = f1, f1 = swap;
    }
    double *row = sums;
    long size = 2 * (lag + 1);
    spectrum(row, row, n, out);
    spectrum(row + size, row + size, n, out + size);
    spectrum(row + 2 * size, row + 3 * size, n, out + 2 * size);
}
