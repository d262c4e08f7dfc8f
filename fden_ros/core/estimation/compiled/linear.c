/* SPDX-FileCopyrightText: 2026 fden_ros maintainers
 * SPDX-License-Identifier: Apache-2.0
 *
 * What the errors of a press are at one state, its normal equations, and their weighing over the
 * scales of the errors. The equations stand in error_model.py and solution.py.
 */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "loops.h"

/* How far loading and its age go on a logarithmic scale in each block. */
void fden_clock(int blocks, const double *loaded, const double *seconds, double floor,
                double *state, double *clock)
{
    double last = state[0], age = state[1];
    for (int n = 0; n < blocks; n++) {
        double now = loaded[n], part = last < now ? last / now : 1.0;
        double older = (age + seconds[n]) * part, half = 0.5 * seconds[n];
        double next = older > half ? older : half;
        clock[n] = fabs(log(now / last)) + fabs(log((next + floor) / (age + floor)));
        last = now, age = next;
    }
    state[0] = last, state[1] = age;
}

static double largest(double a, double b)
{
    return a > b ? a : b;
}

void fden_errors(const ErrorsOf *in)
{
    double before = 0.0;
    for (int b = 0; b < in->blocks; b++) {
        /* The mean over the block's two points. */
        int64_t i = in->first[b], k = in->last[b];
        double stiffness = 0.5 * (in->slope[i] + in->slope[k]);
        in->gain[b] = -stiffness * in->surface_factor;
        double variance = in->stress_variance;
        if (in->compression_sd > 0.0) {
            double duration = largest(in->durations[b], in->shortest);
            double fast = stiffness * in->factor * pow(duration, -in->order) * in->compression_sd;
            variance += fast * fast;
        }
        variance /= in->counts[b];
        /* Where the motion bends at the touch, the slope is that of the step behind it. */
        int64_t end = b + 1 < in->blocks ? in->met[b + 1] : in->points;
        double corner = 0.0;
        for (int64_t n = in->met[b]; n < end; n++) {
            double steepest = in->slope[n];
            if (n + 1 < in->points)
                steepest = largest(steepest, in->slope[n + 1]);
            double step = pow(largest(in->steps[n], in->shortest), -in->order);
            double off = in->corner * in->bends[n] * in->steps[n] * steepest * in->factor * step;
            corner = largest(corner, off * off);
        }
        in->noise[b] = variance + corner + before;
        before = corner;
    }
    double last = in->loading[1], age = in->loading[2], time = in->loading[0];
    for (int b = 0; b < in->blocks; b++) {
        double seconds = in->middles[b] - time, clock;
        double loaded = 0.5 * (fabs(in->elastic[in->first[b]]) + fabs(in->elastic[in->last[b]]));
        double state[2] = {last, age};
        loaded += in->floor;
        fden_clock(1, &loaded, &seconds, in->youngest, state, &clock);
        last = state[0], age = state[1];
        in->rough[b] = in->stress[b] * in->stress[b] * clock;
        in->drifts[b] = in->drift * seconds;
        in->motions[b] = in->motion * seconds;
        time = in->middles[b];
    }
    in->loading[0] = time, in->loading[1] = last, in->loading[2] = age;
}

/* Whiten rows by a Kalman filter of two random walks. */
CLONED double fden_whiten(const Walks *walks, int columns, double *rows, double *means)
{
    double *state = walks->covariance, p00 = state[0], p01 = state[1], p11 = state[2];
    double log_determinant = 0.0, *of_surface = means + columns;
    for (int n = 0; n < walks->blocks; n++) {
        double h = walks->gain[n];
        p00 += walks->roughness * walks->rough[n] + walks->drift[n];
        p11 += walks->surface * walks->motion[n];
        double a = p00 + h * p01, b = p01 + h * p11;
        double s = a + h * b + walks->noise[n], root = 1.0 / sqrt(s), ka = a / s, kb = b / s;
        double *restrict row = rows + (size_t)n * columns;
        for (int k = 0; k < columns; k++) {
            double e = row[k] - means[k] - h * of_surface[k];
            means[k] += ka * e;
            of_surface[k] += kb * e;
            row[k] = e * root;
        }
        p00 -= ka * a;
        p01 -= ka * b;
        p11 -= kb * b;
        log_determinant += log(s);
    }
    state[0] = p00, state[1] = p01, state[2] = p11;
    return log_determinant;
}

/* Whiten rows, and add up what each two columns have in common: four rows at a time. */
CLONED double fden_equations(const Walks *walks, int columns, double *rows, double *means,
                             double *normal)
{
    double found = fden_whiten(walks, columns, rows, means);
    memset(normal, 0, sizeof(double) * columns * (size_t)columns);
    int n = 0, blocks = walks->blocks;
    for (; n + 4 <= blocks; n += 4) {
        const double *restrict r0 = rows + (size_t)n * columns, *restrict r1 = r0 + columns;
        const double *restrict r2 = r1 + columns, *restrict r3 = r2 + columns;
        for (int i = 0; i < columns; i++) {
            double a = r0[i], b = r1[i], c = r2[i], d = r3[i];
            double *restrict to = normal + (size_t)i * columns;
            for (int j = i; j < columns; j++)
                to[j] += (a * r0[j] + b * r1[j]) + (c * r2[j] + d * r3[j]);
        }
    }
    for (; n < blocks; n++) {
        const double *restrict row = rows + (size_t)n * columns;
        for (int i = 0; i < columns; i++) {
            double a = row[i], *restrict to = normal + (size_t)i * columns;
            for (int j = i; j < columns; j++)
                to[j] += a * row[j];
        }
    }
    for (int i = 0; i < columns; i++)
        for (int j = 0; j < i; j++)
            normal[(size_t)i * columns + j] = normal[(size_t)j * columns + i];
    return found;
}

/* An extended Kalman filter: predict and update, block by block. */
CLONED int fden_follow(const Followed *in, double *mean, double *covariance, double *found)
{
    const Walks *walks = &in->walks;
    int n = in->unknowns, size = n + 2, failed = 0;
    double *row = calloc(2 * (size_t)size, sizeof(double)), *gains = row + size;
    found[3] = 0.0;
    for (int b = 0; row && b < walks->blocks && !failed; b++) {
        const double *by = in->jacobian + (size_t)b * n;
        double *of_stress = covariance + (size_t)n * size, *of_surface = of_stress + size;
        of_stress[n] += walks->roughness * walks->rough[b] + walks->drift[b];
        of_surface[n + 1] += walks->surface * walks->motion[b];
        double predicted = in->predicted[b], variance = walks->noise[b];
        for (int k = 0; k < n; k++) {
            row[k] = by[k] * in->free[k];
            predicted += row[k] * (mean[k] - in->about[k]);
        }
        row[n] = 1.0, row[n + 1] = walks->gain[b];
        predicted += mean[n] + row[n + 1] * mean[n + 1];
        for (int i = 0; i < size; i++) {
            const double *restrict own = covariance + (size_t)i * size;
            double sum = 0.0;
            for (int j = 0; j < size; j++)
                sum += own[j] * row[j];
            gains[i] = sum;
            variance += row[i] * sum;
        }
        double innovation = in->observed[b] - predicted;
        failed = !isfinite(innovation) || !(variance > 0.0) || !isfinite(variance);
        for (int i = 0; i < size && !failed; i++) {
            double gain = gains[i] / variance, *restrict own = covariance + (size_t)i * size;
            mean[i] += gain * innovation;
            for (int j = 0; j < size; j++)
                own[j] -= gain * gains[j];
        }
        found[0] = predicted, found[1] = innovation, found[2] = variance;
        found[3] -= 0.5 * (innovation * innovation / variance + log(variance));
    }
    failed |= !row;
    free(row);
    return failed;
}

/* Rows lie a multiple of GROUP apart, and loops go over whole groups: what they do below a diagonal or
 * beyond a row's end is of no use and does no harm. */
static int padded(int size)
{
    return (size + GROUP - 1) / GROUP * GROUP;
}

/* Cholesky's elimination of rows `from` to `to` of a symmetric system [A, b]. */
static INLINE int eliminate_rows(double *rows, int size, int stride, int from, int to)
{
    for (int k = from; k < to; k++) {
        double *restrict pivot = rows + (size_t)k * stride;
        if (!(pivot[k] > 0.0))
            return 1;
        double unit = 1.0 / sqrt(pivot[k]);
        int groups = stride / GROUP;
        for (int j = k / GROUP * GROUP; j < groups * GROUP; j++)
            pivot[j] *= unit;
        for (int i = k + 1; i < size; i++) {
            double *restrict row = rows + (size_t)i * stride, part = pivot[i];
            for (int j = i / GROUP * GROUP; j < groups * GROUP; j++)
                row[j] -= part * pivot[j];
        }
    }
    return 0;
}

/* x of U x = b, where U is the upper triangle of [U, b]. */
static void back(const double *rows, int size, int stride, double *found)
{
    for (int k = size - 1; k >= 0; k--) {
        const double *row = rows + (size_t)k * stride;
        double left = row[size];
        for (int j = k + 1; j < size; j++)
            left -= row[j] * found[j];
        found[k] = left / row[k];
    }
}

CLONED int fden_solve(int size, const double *matrix, const double *side, double *found)
{
    int stride = padded(size + 1);
    double *rows = calloc((size_t)size * stride + 1, sizeof(double));
    if (!rows)
        return 1;
    for (int i = 0; i < size; i++) {
        memcpy(rows + (size_t)i * stride, matrix + (size_t)i * size, sizeof(double) * size);
        rows[(size_t)i * stride + size] = side[i];
    }
    int failed = eliminate_rows(rows, size, stride, 0, size);
    if (!failed)
        back(rows, size, stride, found);
    free(rows);
    return failed;
}

/* Add a prior to the block of a system that begins at a place; return its pull. */
static double add_prior(const Scaled *in, double *rows, int place, int stop, const double *prior,
                        double factor)
{
    int n = in->size, stride = padded(n + 1), width = stop - place;
    double all = 0.0;
    for (int i = place; i < stop; i++) {
        double pull = 0.0;
        const double *own = prior + (size_t)(i - place) * width;
        double *row = rows + (size_t)i * stride;
        for (int j = place; j < stop; j++) {
            row[j] += factor * own[j - place];
            pull += factor * own[j - place] * in->off[j];
        }
        row[n] += pull;
        all += pull * in->off[i];
    }
    return all;
}

static double begun(const Scaled *in, double *rows)
{
    int n = in->size, stride = padded(n + 1);
    for (int i = 0; i < n; i++) {
        memcpy(rows + (size_t)i * stride, in->normal + (size_t)i * n, sizeof(double) * n);
        rows[(size_t)i * stride + n] = in->towards[i];
    }
    return add_prior(in, rows, 0, n, in->base, 1.0);
}

static double with_kernel(const Scaled *in, double *rows, double scale)
{
    double pull = begun(in, rows);
    if (in->kernel_prior)
        pull += add_prior(in, rows, in->kernel, in->characteristic, in->kernel_prior, scale);
    return pull;
}

static double with_characteristic(const Scaled *in, double *rows, double scale)
{
    if (!in->characteristic_prior)
        return 0.0;
    return add_prior(in, rows, in->characteristic, in->size, in->characteristic_prior, scale);
}

static void hold(const Scaled *in, double *rows)
{
    int n = in->size, stride = padded(n + 1);
    for (int held = 0; in->held >> held; held++) {
        if (!(in->held >> held & 1))
            continue;
        for (int j = 0; j < stride; j++)
            rows[(size_t)held * stride + j] = 0.0;
        for (int i = 0; i < n; i++)
            rows[(size_t)i * stride + held] = 0.0;
        rows[(size_t)held * stride + held] = 1.0;
    }
}

/* What the evidence gains at each place of the grid, 2 (kernel, characteristic) inverse squares
 * each: half of the square of the whitened gradient less the pull, less ln |A| / 2. What the
 * places of one kernel have in common is eliminated once. */
CLONED int fden_weigh(const Scaled *in, int places, const double *scales, double *gains)
{
    int n = in->size, stride = padded(n + 1), from = in->characteristic;
    size_t count = (size_t)n * stride;
    double *shared = calloc(2 * count + 1, sizeof(double)), *rows = shared + count;
    double pull = 0.0;
    int failed = !shared;
    for (int p = 0; p < places && !failed; p++) {
        const double *scale = scales + 2 * p;
        if (p == 0 || scale[0] != scale[-2]) {
            pull = with_kernel(in, shared, scale[0]);
            hold(in, shared);
            failed = eliminate_rows(shared, n, stride, 0, from);
        }
        memcpy(rows, shared, count * sizeof(double));
        double own = pull + with_characteristic(in, rows, scale[1]);
        failed |= eliminate_rows(rows, n, stride, from, n);
        double volume = 0.0, square = 0.0;
        for (int k = 0; k < n; k++) {
            const double *row = rows + (size_t)k * stride;
            volume += log(row[k]);
            square += row[n] * row[n];
        }
        gains[p] = 0.5 * (square - own) - volume;
    }
    free(shared);
    return failed;
}

/* Rows of U^-T; A^-1 = U^-1 U^-T is the sum of their outer products. */
static INLINE void invert(const double *rows, int size, int stride, double *roots)
{
    for (int i = 0; i < size; i++) {
        double *restrict own = roots + (size_t)i * stride;
        memset(own, 0, sizeof(double) * stride);
        own[i] = 1.0;
        for (int k = 0; k < i; k++) {
            double part = rows[(size_t)k * stride + i];
            const double *restrict other = roots + (size_t)k * stride;
            int groups = k / GROUP + 1;
            for (int j = 0; j < groups * GROUP; j++)
                own[j] -= part * other[j];
        }
        double unit = 1.0 / rows[(size_t)i * stride + i];
        for (int j = 0; j <= i; j++)
            own[j] *= unit;
    }
}

/* Add to the lower triangle of a sum the outer product of a row. */
static INLINE void add_square(double *sum, const double *restrict row, int count, int stride,
                              double weight)
{
    for (int i = 0; i < count; i++) {
        double part = weight * row[i], *restrict to = sum + (size_t)i * stride;
        int groups = i / GROUP + 1;
        for (int j = 0; j < groups * GROUP; j++)
            to[j] += part * row[j];
    }
}

/* Add up the moments of the steps at places of the grid: weight (step, A^-1 + step step^T). */
CLONED int fden_mix(const Scaled *in, int places, const double *scales, const double *weights,
                    double *mean, double *second)
{
    int n = in->size, stride = padded(n + 1);
    size_t count = (size_t)n * stride;
    double *rows = calloc(3 * count + stride + 1, sizeof(double));
    double *roots = rows + count, *sum = roots + count, *step = sum + count;
    int failed = !rows;
    for (int p = 0; p < places && !failed; p++) {
        with_kernel(in, rows, scales[2 * p]);
        with_characteristic(in, rows, scales[2 * p + 1]);
        hold(in, rows);
        failed = eliminate_rows(rows, n, stride, 0, n);
        if (failed)
            break;
        back(rows, n, stride, step);
        invert(rows, n, stride, roots);
        for (int i = 0; i < n; i++)
            mean[i] += weights[p] * step[i];
        add_square(sum, step, n, stride, weights[p]);
        for (int k = 0; k < n; k++)
            add_square(sum, roots + (size_t)k * stride, k + 1, stride, weights[p]);
    }
    for (int i = 0; i < n && !failed; i++)
        for (int j = 0; j <= i; j++) {
            second[(size_t)i * n + j] += sum[(size_t)i * stride + j];
            second[(size_t)j * n + i] = second[(size_t)i * n + j];
        }
    free(rows);
    return failed;
}
