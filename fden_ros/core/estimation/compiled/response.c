/* SPDX-FileCopyrightText: 2026 fden_ros maintainers
 * SPDX-License-Identifier: Apache-2.0
 *
 * The response of the law to a motion, with its derivatives: the equations stand in loops.py. A
 * step is solved for the law first, then all derivatives go through it side by side, eight at a
 * time.
 */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "loops.h"

#define NODES 4
#define LARGEST_EXPONENT 60.0
/* Newton's method ends after so many steps, or with a change of the compression below this: what is
 * linear in the change is made good, and its square is rounding. */
#define NEWTON_STEPS 12
#define SMALL_CHANGE 1e-9

/* Gauss-Lobatto nodes on [0, 1]; and the Legendre coefficients of the derivative of the cubic
 * through values there. */
static const double PLACES[NODES] = {0.0, 0.27639320225002106, 0.72360679774997894, 1.0};
static const double SLOPES[3][NODES] = {
    {-0.5, 0.0, 0.0, 0.5},
    {1.25, -1.25, -1.25, 1.25},
    {-1.25, 2.795084971874737, -2.795084971874737, 1.25},
};

typedef struct {
    double value, by_compression, by_log_gn, weights[3];
    int knot;
} Elastic;

static Elastic elastic_of(const Law *law, double compression)
{
    Elastic result = {0.0, 0.0, 0.0, {0.0, 0.0, 0.0}, 0};
    double size = fabs(compression), sign = compression < 0.0 ? -1.0 : 1.0;
    if (compression <= 0.0 && (law->one_sided != 0.0 || compression == 0.0)) {
        if (law->power == 1.0 && compression == 0.0) {
            result.by_compression = law->g;
            if (law->knots)
                result.by_compression *= exp(0.5 * (law->bend[0] + law->bend[1]));
        }
        return result;
    }
    double strain = size, slope = 1.0;
    if (law->power != 1.0) {
        double root = sqrt(size), factor = 0.0, steep = 0.0;
        for (int k = TERMS; k > 0; k--) {
            factor = root * (factor + law->series[k - 1]);
            steep = root * (steep + (1.0 + 0.5 * k / law->power) * law->series[k - 1]);
        }
        /* A sphere needs no pow(). */
        double lead = law->power == 1.5 ? root : pow(size, law->power - 1.0);
        strain = size * lead * (1.0 + factor);
        slope = law->power * lead * (1.0 + steep);
    }
    double scaled = law->gn * strain, by_strain, by_log_gn, ratio, bend = 0.0, tilt = 0.0;
    double excess = scaled - 1.0, capped = excess < LARGEST_EXPONENT ? excess : LARGEST_EXPONENT;
    if (law->knots) {
        /* Quadratic splines, evenly spaced in ln(1 + strain / (last_knot / 10)). */
        double near = 0.1 * law->last_knot, cells = law->knots - 2;
        double per_place = cells / log(11.0), at = per_place * log1p(strain / near);
        int is_inside = at < cells, k = is_inside ? (int)at : law->knots - 3;
        double p = at - k, by_strain_of_at = per_place / (near + strain);
        const double *bends = law->bend + k;
        result.knot = k;
        /* Beyond the last knot they go on straight: a kink there would hold a solution up. */
        result.weights[0] = is_inside ? 0.5 * (1.0 - p) * (1.0 - p) : 0.0;
        result.weights[1] = is_inside ? 0.5 + p * (1.0 - p) : 1.5 - p;
        result.weights[2] = is_inside ? 0.5 * p * p : p - 0.5;
        double q = is_inside ? p : 1.0;
        for (int j = 0; j < 3; j++)
            bend += result.weights[j] * bends[j];
        tilt = by_strain_of_at
               * ((q - 1.0) * bends[0] + (1.0 - 2.0 * q) * bends[1] + q * bends[2]);
    }
    /* By how much the exponentials of the law and of its error raise it, both in one. */
    double unit = law->g / law->gn * exp(bend + (excess > 0.0 ? capped : 0.0));
    ratio = excess > 0.0 ? 1.0 + excess - capped : scaled;
    by_strain = law->gn;
    by_log_gn = scaled;
    result.value = sign * unit * ratio;
    result.by_compression = unit * (by_strain + tilt * ratio) * slope;
    result.by_log_gn = sign * unit * (by_log_gn - ratio);
    return result;
}

/* e^-y and the integrals of e^(-y (1 - s) / 2) P_k(s) over -1 < s < 1, for k = 0, 1, 2. */
static void moments_of(double y, double *decay, double *m0, double *m1, double *m2)
{
    double z = 0.5 * y;
    if (z < 0.7) {
        double square = 0.5 * z * z, i0 = 1.0, i1 = 1.0, i2 = 1.0, t0 = 1.0, t1 = 1.0, t2 = 1.0;
        for (int j = 1; j < 9; j++) {
            t0 *= square / (j * (2.0 * j + 1.0));
            t1 *= square / (j * (2.0 * j + 3.0));
            t2 *= square / (j * (2.0 * j + 5.0));
            i0 += t0, i1 += t1, i2 += t2;
        }
        double half = exp(-z);
        *decay = half * half;
        *m0 = 2.0 * half * i0;
        *m1 = 2.0 * half * z / 3.0 * i1;
        *m2 = 2.0 * half * z * z / 15.0 * i2;
        return;
    }
    double e = exp(-y), plus = 1.0 + e, minus = 1.0 - e;
    *decay = e;
    *m0 = minus / z;
    *m1 = (plus - minus / z) / z;
    *m2 = (minus * (1.0 + 3.0 / (z * z)) - 3.0 * plus / z) / z;
}

void fden_moments(int steps, const double *durations, const double *rates, double *moments)
{
    for (int n = 0; n < steps; n++) {
        double *to = moments + (size_t)n * 4 * RATES;
        for (int i = 0; i < RATES; i++)
            moments_of(rates[i] * durations[n], to + i, to + RATES + i, to + 2 * RATES + i,
                       to + 3 * RATES + i);
    }
}

/* Where in a step the elastic response begins or ceases to exceed the free surface. */
static double crossing(const Law *law, double c0, double c1, double f0, double f1, int rises)
{
    if (f0 == 0.0 && f1 == 0.0)
        return -c0 / (c1 - c0);
    double low = 0.0, high = 1.0;
    for (int k = 0; k < 60; k++) {
        double at = 0.5 * (low + high);
        double above = elastic_of(law, c0 + at * (c1 - c0)).value - (f0 + at * (f1 - f0));
        if ((above > 0.0) == (rises != 0))
            high = at;
        else
            low = at;
    }
    return 0.5 * (low + high);
}

static int is_active(const Law *law, const Elastic *at, double compression, double surface)
{
    if (law->one_sided == 0.0)
        return 1;
    return compression > 0.0 && !(at->value <= surface);
}


static INLINE double dot(const double *restrict a, const double *restrict b)
{
    double sum[GROUP];
    for (int j = 0; j < GROUP; j++)
        sum[j] = a[j] * b[j];
    for (int i = GROUP; i < RATES; i += GROUP)
        for (int j = 0; j < GROUP; j++)
            sum[j] += a[i + j] * b[i + j];
    return ((sum[0] + sum[1]) + (sum[2] + sum[3])) + ((sum[4] + sum[5]) + (sum[6] + sum[7]));
}

/* One step: which part of it is active, and what its values weigh at its end. */
typedef struct {
    double begin, end;           /* of the active part, as parts of the step */
    double moments[4][RATES];    /* decay of the step, then the moments, decayed to its end */
    double at_begin[RATES], at_end[RATES]; /* decays from begin and end to the end of the step */
    double left[RATES];          /* weights of the exponentials a step later */
    int was_active, is_on, is_any, is_whole;
    Elastic nodes[NODES];
    double parts[NODES];
    double found[3], by_end[3];  /* coefficients of psi's rate, and their slopes by the end */
    double sums[3];              /* moments times the weights */
    double begin_sum, end_sum;   /* decays from begin and end times the weights */
    double per_second;           /* from a step's sum of coefficients to the rate at its end */
    double start_by_end, stop_by_end;
    double force, stiffness, elastic, compression;
} Step;

static void weigh_moments(Step *step, const double *given, const double *rates,
                          const double *weights, double duration)
{
    memcpy(step->moments, given, sizeof(step->moments));
    if (!step->is_whole) {
        double part = (step->end - step->begin) * duration;
        double after = (1.0 - step->end) * duration, before = (1.0 - step->begin) * duration;
        for (int i = 0; i < RATES; i++) {
            double m[4], tail = exp(-rates[i] * after);
            moments_of(rates[i] * part, m, m + 1, m + 2, m + 3);
            for (int k = 1; k < 4; k++)
                step->moments[k][i] = m[k] * tail;
            step->at_end[i] = tail;
            step->at_begin[i] = exp(-rates[i] * before);
        }
    }
    for (int k = 0; k < 3; k++)
        step->sums[k] = dot(step->moments[k + 1], weights);
    step->begin_sum = step->is_whole ? 0.0 : dot(step->at_begin, weights);
    step->end_sum = step->is_whole ? 0.0 : dot(step->at_end, weights);
}

static void coefficients(const double *values, double *found)
{
    for (int k = 0; k < 3; k++) {
        found[k] = 0.0;
        for (int j = 0; j < NODES; j++)
            found[k] += SLOPES[k][j] * values[j];
    }
}

/* Where the response is. */
typedef struct {
    double kept[RATES]; /* exponentials of the law itself */
    double compression, surface, response, softness, elastic;
    int is_active;
    Elastic at;
} Now;

/* The first point: a record that begins in contact begins with a jump. */
static void begin_at(Step *step, const Law *law, const double *weights, double c1, double f1)
{
    Elastic at = elastic_of(law, c1);
    step->is_on = is_active(law, &at, c1, f1);
    double sum = law->slow;
    for (int i = 0; i < RATES; i++)
        sum += weights[i];
    step->begin_sum = sum;
    step->nodes[NODES - 1] = at;
    step->elastic = step->is_on ? at.value - f1 : 0.0;
    step->force = sum * step->elastic;
    step->stiffness = step->is_on ? sum * at.by_compression : 0.0;
}

/* A step that ends at a compression. */
static void step_to(Step *step, const Law *law, const Response *in, const Now *now, int n,
                    double c1, double f1, double memory, int *is_whole_ready)
{
    const double c0 = now->compression, f0 = now->surface;
    Elastic at = elastic_of(law, c1);
    int was_active = step->was_active = now->is_active;
    int is_on = step->is_on = is_active(law, &at, c1, f1);
    step->nodes[NODES - 1] = at;
    step->begin = 0.0, step->end = 1.0;
    if (!was_active && is_on)
        step->begin = crossing(law, c0, c1, f0, f1, 1);
    else if (was_active && !is_on)
        step->end = crossing(law, c0, c1, f0, f1, 0);
    step->is_any = was_active || is_on;
    step->is_whole = was_active && is_on;
    step->force = memory, step->stiffness = 0.0, step->elastic = 0.0;
    memset(step->found, 0, sizeof(step->found));
    memset(step->by_end, 0, sizeof(step->by_end));
    step->start_by_end = step->stop_by_end = step->per_second = 0.0;
    if (!step->is_any)
        return;
    if (!(step->begin >= 0.0))
        step->begin = 0.0;
    if (!(step->end <= 1.0))
        step->end = 1.0;
    if (!step->is_whole || !*is_whole_ready)
        weigh_moments(step, in->moments + (size_t)n * 4 * RATES, in->rates, in->weights,
                      in->durations[n]);
    *is_whole_ready = step->is_whole;
    double part = (step->end - step->begin) * in->durations[n];
    step->per_second = is_on && part > 0.0 ? 2.0 / part : 0.0;
    double values[NODES], slopes[NODES], fast = law->fast * step->per_second;
    for (int j = 0; j < NODES; j++) {
        step->parts[j] = step->begin + PLACES[j] * (step->end - step->begin);
        double compression = c0 + step->parts[j] * (c1 - c0);
        /* At touch and release rounding must not take the slope away. */
        if (!step->is_whole && compression < 0.0)
            compression = 0.0;
        if (j == 0 && was_active)
            step->nodes[j] = now->at;
        else if (j < NODES - 1 || !is_on)
            step->nodes[j] = elastic_of(law, compression);
        values[j] = step->nodes[j].value - (f0 + step->parts[j] * (f1 - f0));
        slopes[j] = step->nodes[j].by_compression * step->parts[j];
    }
    if (!was_active && is_on && law->one_sided != 0.0)
        values[0] = 0.0;
    if (was_active && !is_on)
        values[NODES - 1] = 0.0;
    coefficients(values, step->found);
    coefficients(slopes, step->by_end);
    for (int k = 0; k < 3; k++) {
        step->force += (step->sums[k] + fast) * step->found[k];
        step->stiffness += (step->sums[k] + fast) * step->by_end[k];
    }
    /* The surface moves where the step touches or releases: jumps of the derivative. */
    step->start_by_end = was_active ? 0.0 : slopes[0];
    step->stop_by_end = is_on ? 0.0 : -slopes[NODES - 1];
    step->stiffness += step->start_by_end * step->begin_sum + step->stop_by_end * step->end_sum;
    step->elastic = is_on ? values[NODES - 1] : 0.0;
    step->force += law->slow * step->elastic;
    if (is_on)
        step->stiffness += law->slow * at.by_compression;
}

/* Bring the law itself to the next point. Returns 1 where something is not finite. */
static int solve_step(Step *step, const Law *law, const Response *in, Now *now, int n, int first)
{
    double f1 = in->surface ? in->surface[n] : 0.0, target = in->compressions[n], c1 = target;
    double memory = 0.0, compliance = law->compliance;
    int is_whole_ready = 0;
    Elastic at = now->at;
    if (!first) {
        const double *decay = in->moments + (size_t)n * 4 * RATES;
        for (int i = 0; i < RATES; i++)
            step->left[i] = in->weights[i] * decay[i];
        memory = dot(step->left, now->kept);
        if (compliance != 0.0) {
            c1 -= compliance * now->response;
            if (now->is_active) /* what the step adds to the stress, by the last slope */
                c1 = now->compression + now->softness * (c1 - now->compression);
        }
    }
    for (int tries = 0; tries < NEWTON_STEPS; tries++) {
        if (first)
            begin_at(step, law, in->weights, c1, f1);
        else
            step_to(step, law, in, now, n, c1, f1, memory, &is_whole_ready);
        at = step->nodes[NODES - 1];
        if (!first && !step->is_on)
            at = elastic_of(law, c1);
        if (compliance == 0.0)
            break;
        double miss = c1 - target + compliance * step->force;
        double change = miss / (1.0 + compliance * step->stiffness);
        c1 -= change;
        if (fabs(change) < SMALL_CHANGE) {
            step->force -= step->stiffness * change;
            at.value -= at.by_compression * change;
            step->nodes[NODES - 1].value -= step->nodes[NODES - 1].by_compression * change;
            if (step->is_on)
                step->elastic -= at.by_compression * change;
            for (int k = 0; !first && k < 3; k++)
                step->found[k] -= step->by_end[k] * change;
            break;
        }
    }
    step->compression = c1;
    if (!isfinite(step->force) || !isfinite(c1))
        return 1;
    if (first) {
        for (int i = 0; i < RATES; i++)
            now->kept[i] = step->elastic;
    } else if (step->is_any) {
        const double *found = step->found;
        for (int i = 0; i < RATES; i++)
            now->kept[i] = now->kept[i] * step->moments[0][i] + found[0] * step->moments[1][i]
                           + found[1] * step->moments[2][i] + found[2] * step->moments[3][i];
    } else {
        const double *decay = in->moments + (size_t)n * 4 * RATES;
        for (int i = 0; i < RATES; i++)
            now->kept[i] *= decay[i];
    }
    now->at = at;
    now->elastic = step->elastic;
    now->softness = 1.0 / (1.0 + compliance * step->stiffness);
    return 0;
}

/* The derivatives side by side: each row has `width` of them, a multiple of GROUP. */
typedef struct {
    int width;
    double *kept;      /* exponentials, (RATES, width) */
    double *changes;   /* derivatives of their weights, likewise */
    double *slow, *fast; /* and of the slow and the fast one */
    int change_from, change_to; /* columns that have such */
    double *moved, *lifted, *total;
    double *direct, *raised, *column;
    double *nodes[NODES];
    double *parts[3], *start, *stop;
    int log_g, log_gn, compliance, *knots; /* columns by these; -1: none */
} Columns;

#define SINGLE_ROWS 17
#define ROWS (2 * RATES + SINGLE_ROWS)

static int allot(Columns *to, const Response *in)
{
    int width = to->width = (in->columns + GROUP - 1) / GROUP * GROUP;
    double *room = to->kept = calloc((size_t)width * ROWS + 1, sizeof(double));
    to->knots = malloc(sizeof(int) * (in->law.knots + 3));
    if (!room || !to->knots)
        return 1;
    double **rows[SINGLE_ROWS] = {
        &to->slow, &to->fast, &to->moved, &to->lifted, &to->total, &to->direct, &to->raised,
        &to->column, &to->nodes[0], &to->nodes[1], &to->nodes[2], &to->nodes[3], &to->parts[0],
        &to->parts[1], &to->parts[2], &to->start, &to->stop,
    };
    to->changes = room + (size_t)width * RATES;
    for (int r = 0; r < SINGLE_ROWS; r++)
        *rows[r] = room + (size_t)width * (2 * RATES + r);
    for (int m = 0; m < in->law.knots + 3; m++)
        to->knots[m] = -1;
    to->log_g = to->log_gn = to->compliance = -1;
    to->change_from = width, to->change_to = 0;
    for (int k = 0; k < in->columns; k++) {
        int kind = (int)in->kinds[k];
        if (kind == BY_LOG_G)
            to->log_g = k;
        if (kind == BY_LOG_GN)
            to->log_gn = k;
        if (kind == BY_COMPLIANCE)
            to->compliance = k;
        if (kind >= BY_FIRST_KNOT && kind - BY_FIRST_KNOT < in->law.knots)
            to->knots[kind - BY_FIRST_KNOT] = k;
        if (in->weight_of[k] < 0)
            continue;
        const double *change = in->weight_changes + (size_t)in->weight_of[k] * (RATES + 2);
        for (int i = 0; i < RATES; i++)
            to->changes[(size_t)i * width + k] = change[i];
        to->slow[k] = change[RATES], to->fast[k] = change[RATES + 1];
        if (to->change_from == width)
            to->change_from = k / GROUP * GROUP;
        to->change_to = (k / GROUP + 1) * GROUP;
    }
    return 0;
}

/* Add what the law itself changes at a node. */
static INLINE void add_law(const Columns *to, const Elastic *at, double *values)
{
    if (to->log_g >= 0)
        values[to->log_g] += at->value;
    if (to->log_gn >= 0)
        values[to->log_gn] += at->by_log_gn;
    for (int j = 0; j < 3; j++)
        if (to->knots[at->knot + j] >= 0)
            values[to->knots[at->knot + j]] += at->value * at->weights[j];
}

/* to[k] += sum of weights times rows, over so many columns. */
static INLINE void add_rows(double *restrict to, const double *restrict rows,
                            const double *restrict weights, int stride, int from, int end)
{
    double *restrict own = to + from;
    for (int i = 0; i < RATES; i += 4) {
        const double *restrict r = rows + (size_t)i * stride + from;
        double a = weights[i], b = weights[i + 1], c = weights[i + 2], d = weights[i + 3];
        for (int k = 0; k < ((end - from) & -GROUP); k++)
            own[k] += (a * r[k] + b * r[stride + k])
                      + (c * r[2 * stride + k] + d * r[3 * stride + k]);
    }
}

/* Bring exponentials to the end of a step. */
static INLINE void advance(double *restrict kept, const double moments[4][RATES],
                           const double *restrict p0, const double *restrict p1,
                           const double *restrict p2, int width)
{
    for (int i = 0; i < RATES; i++) {
        double *restrict own = kept + (size_t)i * width;
        double decay = moments[0][i], m0 = moments[1][i], m1 = moments[2][i], m2 = moments[3][i];
        for (int k = 0; k < (width & -GROUP); k++)
            own[k] = (own[k] * decay + p0[k] * m0) + (p1[k] * m1 + p2[k] * m2);
    }
}

/* What psi of a column is at a node, but for the law's own change. */
static INLINE void at_node(double *restrict values, const Columns *to, double slope, double part)
{
    const double *restrict moved = to->moved, *restrict direct = to->direct;
    const double *restrict lifted = to->lifted, *restrict raised = to->raised;
    int width = to->width;
    for (int k = 0; k < (width & -GROUP); k++)
        values[k] = slope * (moved[k] + part * (direct[k] - moved[k]))
                    - (lifted[k] + part * (raised[k] - lifted[k]));
}

static INLINE void combine(double *restrict to, double *const nodes[NODES], const double *weights,
                           int width)
{
    const double *restrict n0 = nodes[0], *restrict n1 = nodes[1];
    const double *restrict n2 = nodes[2], *restrict n3 = nodes[3];
    double a = weights[0], b = weights[1], c = weights[2], d = weights[3];
    for (int k = 0; k < (width & -GROUP); k++)
        to[k] = (a * n0[k] + b * n1[k]) + (c * n2[k] + d * n3[k]);
}

static INLINE void add(double *restrict to, const double *restrict from, double factor, int width)
{
    for (int k = 0; k < (width & -GROUP); k++)
        to[k] += factor * from[k];
}

static INLINE void scale(double *restrict to, const double *restrict from, double factor, int width)
{
    for (int k = 0; k < (width & -GROUP); k++)
        to[k] = factor * from[k];
}

static INLINE void stretch(double *restrict to, double factor, int width)
{
    for (int k = 0; k < (width & -GROUP); k++)
        to[k] *= factor;
}

/* The derivatives of the stress at the end of a step, given the compression there. */
static INLINE void columns_at_end(const Columns *to, const Step *step, const Law *law, int first)
{
    int width = to->width;
    if (first) {
        const Elastic *at = &step->nodes[NODES - 1];
        at_node(to->total, to, at->by_compression, 1.0);
        add_law(to, at, to->total);
        stretch(to->total, step->is_on ? 1.0 : 0.0, width);
        scale(to->column, to->total, step->begin_sum, width);
        return;
    }
    memset(to->column, 0, sizeof(double) * width);
    add_rows(to->column, to->kept, step->left, width, 0, width);
    if (!step->is_any) {
        memset(to->total, 0, sizeof(double) * width);
        return;
    }
    for (int j = 0; j < NODES; j++) {
        at_node(to->nodes[j], to, step->nodes[j].by_compression, step->parts[j]);
        add_law(to, &step->nodes[j], to->nodes[j]);
    }
    for (int m = 0; m < 3; m++) {
        combine(to->parts[m], to->nodes, SLOPES[m], width);
        add(to->column, to->parts[m], step->sums[m] + law->fast * step->per_second, width);
    }
    scale(to->total, to->nodes[NODES - 1], step->is_on ? 1.0 : 0.0, width);
    add(to->column, to->total, law->slow, width);
    if (step->is_whole)
        return;
    scale(to->start, to->nodes[0], step->was_active ? 0.0 : 1.0, width);
    scale(to->stop, to->nodes[NODES - 1], step->is_on ? 0.0 : -1.0, width);
    add(to->column, to->start, step->begin_sum, width);
    add(to->column, to->stop, step->end_sum, width);
}

/* What the stress takes off the compression is taken off again. */
static INLINE void columns_comply(const Columns *to, const Step *step, double compliance, int first)
{
    int width = to->width, is_moved = !first && step->is_any;
    double *extra = to->nodes[0]; /* no longer used */
    stretch(to->column, 1.0 / (1.0 + compliance * step->stiffness), width);
    scale(extra, to->column, -compliance, width);
    add(to->direct, extra, 1.0, width);
    if (step->is_on && (first || is_moved))
        add(to->total, extra, step->nodes[NODES - 1].by_compression, width);
    for (int m = 0; is_moved && m < 3; m++)
        add(to->parts[m], extra, step->by_end[m], width);
    if (is_moved && !step->is_whole) {
        add(to->start, extra, step->start_by_end, width);
        add(to->stop, extra, step->stop_by_end, width);
    }
}

/* Bring all derivatives through a step that the law has made. */
CLONED static void columns_step(const Columns *to, const Step *step, const Law *law,
                                const double *law_kept, int first)
{
    int width = to->width;
    columns_at_end(to, step, law, first);
    add_rows(to->column, to->changes, law_kept, width, to->change_from, to->change_to);
    add(to->column, to->slow, step->elastic, width);
    if (!first && step->is_any)
        add(to->column, to->fast,
            step->per_second * (step->found[0] + step->found[1] + step->found[2]), width);
    if (law->compliance != 0.0)
        columns_comply(to, step, law->compliance, first);
    if (first) {
        for (int i = 0; i < RATES; i++)
            memcpy(to->kept + (size_t)i * width, to->total, sizeof(double) * width);
    } else if (step->is_any) {
        advance(to->kept, step->moments, to->parts[0], to->parts[1], to->parts[2], width);
        for (int i = 0; !step->is_whole && i < RATES; i++) {
            add(to->kept + (size_t)i * width, to->start, step->at_begin[i], width);
            add(to->kept + (size_t)i * width, to->stop, step->at_end[i], width);
        }
    } else {
        for (int i = 0; i < RATES; i++) {
            double *own = to->kept + (size_t)i * width;
            stretch(own, step->moments[0][i], width);
        }
    }
    memcpy(to->moved, to->direct, sizeof(double) * width);
    memcpy(to->lifted, to->raised, sizeof(double) * width);
}

/* The state lies as rows of RATES, the law's first; then what they add up to, the derivatives of
 * compression and of free surface; then compression, free surface, active, response, softness. */
static void exchange(const Response *in, Columns *to, Now *now, int is_saved)
{
    int columns = in->columns;
    double *rows = in->state, *totals = rows + (size_t)(columns + 1) * RATES;
    double *last = totals + 3 * (columns + 1);
    double *numbers[] = {&now->compression, &now->surface, 0, &now->response, &now->softness};
    if (is_saved)
        totals[0] = now->elastic;
    for (int i = 0; i < RATES; i++)
        *(is_saved ? rows + i : now->kept + i) = *(is_saved ? now->kept + i : rows + i);
    for (int k = 0; k < columns; k++) {
        double *own = to->kept + k;
        double *row = rows + (size_t)(k + 1) * RATES;
        double *pairs[3][2] = {{totals + k + 1, to->total + k},
                               {totals + columns + 2 + k, to->moved + k},
                               {totals + 2 * columns + 3 + k, to->lifted + k}};
        for (int i = 0; i < RATES; i++)
            *(is_saved ? row + i : own + i * to->width) = *(is_saved ? own + i * to->width : row + i);
        for (int m = 0; m < 3; m++)
            *pairs[m][!is_saved] = *pairs[m][is_saved];
    }
    for (int m = 0; m < 5; m++)
        if (m != 2)
            *(is_saved ? last + m : numbers[m]) = *(is_saved ? numbers[m] : last + m);
    if (is_saved)
        last[2] = now->is_active;
    else
        now->is_active = last[2] != 0.0;
}

int fden_response(const Response *in)
{
    const Law *law = &in->law;
    Now now;
    Step step;
    Columns to;
    memset(&now, 0, sizeof(now));
    memset(&step, 0, sizeof(step));
    int failed = allot(&to, in), block = 0, columns = in->columns;
    if (in->is_begun && !failed) {
        exchange(in, &to, &now, 0);
        now.at = elastic_of(law, now.compression);
    }
    memset(in->stress, 0, sizeof(double) * in->blocks);
    memset(in->jacobian, 0, sizeof(double) * in->blocks * (size_t)columns);
    for (int n = 0; n < in->points && !failed; n++) {
        int first = n == 0 && !in->is_begun;
        failed = solve_step(&step, law, in, &now, n, first);
        if (failed)
            break;
        in->elastics[n] = now.at.value;
        /* What is off the probe does not feel its motion. */
        in->slopes[n] = step.is_on ? now.at.by_compression : 0.0;
        if (columns) {
            for (int k = 0; k < columns; k++) {
                to.direct[k] = k < in->moving ? in->motions[(size_t)k * in->points + n] : 0.0;
                to.raised[k] = in->surfaces ? in->surfaces[(size_t)k * in->points + n] : 0.0;
            }
            if (to.compliance >= 0)
                to.direct[to.compliance] = -step.force;
            if (!first && !step.is_any)
                memcpy(step.moments, in->moments + (size_t)n * 4 * RATES, sizeof(step.moments));
            columns_step(&to, &step, law, now.kept, first);
        }
        now.compression = step.compression;
        now.surface = in->surface ? in->surface[n] : 0.0;
        now.is_active = step.is_on;
        now.response = step.force;
        /* A block is the mean of its two points, which are one where it is one sample. */
        for (int end = 0; end < 2 && block < in->blocks; end++) {
            if ((end ? in->last : in->first)[block] != n)
                continue;
            double *row = in->jacobian + (size_t)block * columns;
            in->stress[block] += 0.5 * step.force;
            for (int k = 0; k < columns; k++)
                row[k] += 0.5 * to.column[k];
            block += end;
        }
    }
    if (!failed && in->points)
        exchange(in, &to, &now, 1);
    free(to.kept);
    free(to.knots);
    return failed;
}
