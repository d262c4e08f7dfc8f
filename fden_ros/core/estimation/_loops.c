/* SPDX-FileCopyrightText: 2026 fden_ros maintainers
 * SPDX-License-Identifier: Apache-2.0
 *
 * The inner loops of the posterior: the response of the law with its derivatives, and the whitening
 * of residuals. No Python in it: loops.py calls it; names and equations are explained there. From the
 * same functions of loops_in_numpy.py it differs by rounding alone.
 */

#include <math.h>
#include <string.h>

#define RATES 32
#define NODES 4
#define LARGEST_EXPONENT 60.0

/* Compiled for each width of vector; which one runs is seen at its first call. */
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__)
#define CLONED __attribute__((target_clones("avx512f", "avx2", "default")))
#else
#define CLONED
#endif

/* Columns of the response: what of the law a column is the derivative by. */
enum { BY_NOTHING, BY_LOG_G, BY_LOG_GN, BY_COMPLIANCE, BY_FIRST_KNOT };

/* Gauss-Lobatto nodes on [0, 1]; and the Legendre coefficients of the derivative of the cubic
 * through values there. */
static const double PLACES[NODES] = {0.0, 0.27639320225002106, 0.72360679774997894, 1.0};
static const double SLOPES[3][NODES] = {
    {-0.5, 0.0, 0.0, 0.5},
    {1.25, -1.25, -1.25, 1.25},
    {-1.25, 2.795084971874737, -2.795084971874737, 1.25},
};

typedef struct {
    double g, gn, power, one_sided, compliance, slow, fast;
    int knots;
    double last_knot;
    const double *bend;
} Law;

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
        strain = size * sqrt(size);
        slope = 1.5 * sqrt(size);
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
    if (excess <= 0.0) {
        ratio = scaled;
        by_strain = law->gn;
        by_log_gn = scaled;
    } else {
        double grown = exp(capped);
        ratio = grown * (1.0 + excess - capped);
        by_strain = law->gn * grown;
        by_log_gn = scaled * grown;
    }
    double unit = law->g / law->gn * (law->knots ? exp(bend) : 1.0);
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

static double at_knot(const Elastic *at, int knot)
{
    int place = knot - at->knot;
    return place >= 0 && place < 3 ? at->value * at->weights[place] : 0.0;
}

static int is_active(const Law *law, const Elastic *at, double compression, double surface)
{
    if (law->one_sided == 0.0)
        return 1;
    return compression > 0.0 && !(at->value <= surface);
}

/* Exponentials go in groups of eight: sums have eight parts, whatever the width of the vectors. */
#define GROUP 8
#define INLINE inline __attribute__((always_inline))

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

/* Bring exponentials to the end of a step. */
static INLINE void advance(double *restrict own, const double moments[4][RATES], const double *parts)
{
    double p0 = parts[0], p1 = parts[1], p2 = parts[2];
    for (int i = 0; i < RATES; i++)
        own[i] = own[i] * moments[0][i] + p0 * moments[1][i] + p1 * moments[2][i]
                 + p2 * moments[3][i];
}

/* One step: which part of it is active, and what its values weigh at its end. */
typedef struct {
    double begin, end;           /* of the active part, as parts of the step */
    double moments[4][RATES];    /* decay of the step, then the moments, decayed to its end */
    double at_begin[RATES], at_end[RATES]; /* decays from begin and end to the end of the step */
    int is_whole, is_any, ends_active;
    double sums[3];              /* moments times the weights */
    double begin_sum, end_sum;   /* decays from begin and end times the weights */
    double per_second;           /* from a step's sum of coefficients to the rate at its end */
} Step;

static void prepare(Step *step, const double *given, const double *rates, const double *weights,
                    double duration)
{
    if (step->is_whole) {
        memcpy(step->moments, given, sizeof(step->moments));
    } else {
        double part = (step->end - step->begin) * duration;
        double after = (1.0 - step->end) * duration, before = (1.0 - step->begin) * duration;
        for (int i = 0; i < RATES; i++) {
            double m[4], tail = exp(-rates[i] * after);
            moments_of(rates[i] * part, m, m + 1, m + 2, m + 3);
            step->moments[0][i] = given[i];
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
    double part = (step->end - step->begin) * duration;
    step->per_second = step->ends_active && part > 0.0 ? 2.0 / part : 0.0;
}

static void coefficients(const double *values, double *found)
{
    for (int k = 0; k < 3; k++) {
        found[k] = 0.0;
        for (int j = 0; j < NODES; j++)
            found[k] += SLOPES[k][j] * values[j];
    }
}

#define STATE(columns) (((columns) + 1) * (RATES + 3) + 4)

/* The derivative of the elastic response by what a column is by. */
static double of_law(const Elastic *at, int kind)
{
    if (kind == BY_LOG_G)
        return at->value;
    if (kind == BY_LOG_GN)
        return at->by_log_gn;
    return kind >= BY_FIRST_KNOT ? at_knot(at, kind - BY_FIRST_KNOT) : 0.0;
}

/* The response at every point, and its derivatives. See loops.py for the arguments.
 * Returns 0, or 1 where something is not finite. */
CLONED int fden_response(int points, const double *moments, const double *durations, const double *rates,
                  const double *compressions, const double *surface, const double *numbers,
                  int knots, const double *bend, const double *weights, int columns,
                  const int *kinds, int moving, const double *motions, const double *surfaces,
                  const int *weight_of, const double *weight_changes, double *state, int is_begun,
                  double *response, double *jacobian, double *elastics, double *slopes_of)
{
    Law law = {numbers[0], numbers[1], numbers[2], numbers[3], numbers[4], numbers[5], numbers[6],
               knots, numbers[7], bend};
    double *kept = state;                        /* columns + 1 rows of RATES */
    double *totals = state + (columns + 1) * RATES; /* the elastic response and its derivatives */
    double *moved = totals + columns + 1;        /* derivatives of the compression */
    double *lifted = moved + columns + 1;        /* derivatives of the free surface */
    double *last = lifted + columns + 1;         /* compression, free surface, active, response */
    Step step;
    Elastic at = {0.0, 0.0, 0.0, {0.0, 0.0, 0.0}, 0};
    if (is_begun)
        at = elastic_of(&law, last[0]);
    for (int n = 0; n < points; n++) {
        double f1 = surface ? surface[n] : 0.0;
        double c1 = compressions[n];
        int first = n == 0 && !is_begun;
        Elastic nodes[NODES];
        double parts[NODES], values[NODES], found[3] = {0.0, 0.0, 0.0};
        double force = 0.0, stiffness = 0.0, by_end[3] = {0.0, 0.0, 0.0}, elastic = 0.0;
        double start_by_end = 0.0, stop_by_end = 0.0, sum = 0.0, fast = 0.0;
        const double *given = first ? 0 : moments + (size_t)n * 4 * RATES;
        double c0 = last[0], f0 = last[1];
        int was_active = last[2] != 0.0;
        double memory = 0.0, left[RATES]; /* weights of the exponentials a step later */
        if (first) {
            memset(state, 0, sizeof(double) * STATE(columns));
        } else {
            for (int i = 0; i < RATES; i++)
                left[i] = weights[i] * given[i];
            memory = dot(left, kept);
            if (law.compliance != 0.0)
                c1 -= law.compliance * last[3];
        }
        int is_on = 0, is_whole_ready = 0;
        Elastic before_step = at;
        for (int tries = 0; tries < 12; tries++) {
            at = elastic_of(&law, c1);
            is_on = is_active(&law, &at, c1, f1);
            if (first) {
                /* A record that begins in contact begins with a jump. */
                elastic = is_on ? at.value - f1 : 0.0;
                sum = law.slow;
                for (int i = 0; i < RATES; i++)
                    sum += weights[i];
                force = sum * elastic;
                stiffness = is_on ? sum * at.by_compression : 0.0;
                nodes[3] = at;
            } else {
                step.begin = 0.0, step.end = 1.0;
                step.ends_active = is_on;
                if (!was_active && is_on)
                    step.begin = crossing(&law, c0, c1, f0, f1, 1);
                else if (was_active && !is_on)
                    step.end = crossing(&law, c0, c1, f0, f1, 0);
                step.is_any = was_active || is_on;
                step.is_whole = was_active && is_on;
                force = memory, stiffness = 0.0, elastic = 0.0;
                if (step.is_any) {
                    if (!(step.begin >= 0.0))
                        step.begin = 0.0;
                    if (!(step.end <= 1.0))
                        step.end = 1.0;
                    if (!step.is_whole || !is_whole_ready)
                        prepare(&step, given, rates, weights, durations[n]);
                    is_whole_ready = step.is_whole;
                    fast = law.fast * step.per_second;
                    double slopes[NODES];
                    for (int j = 0; j < NODES; j++) {
                        parts[j] = step.begin + PLACES[j] * (step.end - step.begin);
                        double compression = c0 + parts[j] * (c1 - c0);
                        /* At touch and release rounding must not take the slope away. */
                        if (!step.is_whole && compression < 0.0)
                            compression = 0.0;
                        if (j == 0 && was_active)
                            nodes[j] = before_step;
                        else if (j == NODES - 1 && is_on)
                            nodes[j] = at;
                        else
                            nodes[j] = elastic_of(&law, compression);
                        values[j] = nodes[j].value - (f0 + parts[j] * (f1 - f0));
                        slopes[j] = nodes[j].by_compression * parts[j];
                    }
                    if (!was_active && is_on && law.one_sided != 0.0)
                        values[0] = 0.0;
                    if (was_active && !is_on)
                        values[3] = 0.0;
                    coefficients(values, found);
                    coefficients(slopes, by_end);
                    for (int k = 0; k < 3; k++) {
                        force += (step.sums[k] + fast) * found[k];
                        stiffness += (step.sums[k] + fast) * by_end[k];
                    }
                    /* The surface moves where the step touches or releases: jumps of the derivative. */
                    start_by_end = was_active ? 0.0 : slopes[0];
                    stop_by_end = is_on ? 0.0 : -slopes[3];
                    stiffness += start_by_end * step.begin_sum + stop_by_end * step.end_sum;
                    elastic = is_on ? values[3] : 0.0;
                    force += law.slow * elastic;
                    if (is_on)
                        stiffness += law.slow * nodes[3].by_compression;
                }
            }
            if (law.compliance == 0.0)
                break;
            double miss = c1 - compressions[n] + law.compliance * force;
            double change = miss / (1.0 + law.compliance * stiffness);
            c1 -= change;
            if (fabs(change) < 1e-15)
                break;
        }
        if (!isfinite(force) || !isfinite(c1))
            return 1;
        response[n] = force;
        elastics[n] = at.value;
        /* What is off the probe does not feel its motion. */
        slopes_of[n] = is_on ? at.by_compression : 0.0;
        /* The state of the law itself. */
        if (first) {
            for (int i = 0; i < RATES; i++)
                kept[i] = elastic;
        } else if (step.is_any) {
            advance(kept, step.moments, found);
        } else {
            for (int i = 0; i < RATES; i++)
                kept[i] *= given[i];
        }
        totals[0] = elastic;
        double softness = 1.0 / (1.0 + law.compliance * stiffness);
        double rate = first || !step.is_any ? 0.0
                                            : step.per_second * (found[0] + found[1] + found[2]);
        for (int k = 0; k < columns; k++) {
            double *own = kept + (k + 1) * RATES;
            double direct = k < moving ? motions[(size_t)k * points + n] : 0.0;
            if (kinds[k] == BY_COMPLIANCE)
                direct = -force;
            double raised = surfaces ? surfaces[(size_t)k * points + n] : 0.0;
            double before = moved[k + 1], raised_before = lifted[k + 1];
            double total = 0.0, column = 0.0, parts_of[3] = {0.0, 0.0, 0.0};
            double start = 0.0, stop = 0.0;
            int is_moved = 0, is_kept = 0;
            if (first) {
                if (is_on) {
                    const Elastic *at = &nodes[3];
                    total = at->by_compression * direct - raised + of_law(at, kinds[k]);
                }
                column = sum * total;
            } else {
                if (step.is_any) {
                    double column_values[NODES];
                    for (int j = 0; j < NODES; j++) {
                        const Elastic *at = &nodes[j];
                        double value = at->by_compression * (before + parts[j] * (direct - before))
                                       - (raised_before + parts[j] * (raised - raised_before));
                        value += of_law(at, kinds[k]);
                        column_values[j] = value;
                        is_moved |= value != 0.0;
                    }
                    if (is_moved) {
                        coefficients(column_values, parts_of);
                        start = was_active ? 0.0 : column_values[0];
                        stop = is_on ? 0.0 : -column_values[3];
                        total = is_on ? column_values[3] : 0.0;
                    }
                }
                is_kept = own[0] != 0.0 || own[RATES - 1] != 0.0;
                if (is_kept)
                    column = dot(own, left);
                if (is_moved)
                    column += (step.sums[0] + fast) * parts_of[0] + (step.sums[1] + fast) * parts_of[1]
                              + (step.sums[2] + fast) * parts_of[2] + start * step.begin_sum
                              + stop * step.end_sum + law.slow * total;
            }
            if (weight_of[k] >= 0) {
                const double *change = weight_changes + (size_t)weight_of[k] * (RATES + 2);
                column += dot(kept, change) + change[RATES] * totals[0]
                          + change[RATES + 1] * rate;
            }
            double now = direct;
            if (law.compliance != 0.0) {
                /* What the stress takes off the compression is taken off again. */
                column *= softness;
                double extra = -law.compliance * column;
                now += extra;
                if (first && is_on)
                    total += extra * nodes[3].by_compression;
                if (!first && step.is_any) {
                    is_moved = 1;
                    for (int j = 0; j < 3; j++)
                        parts_of[j] += extra * by_end[j];
                    start += extra * start_by_end;
                    stop += extra * stop_by_end;
                    if (is_on)
                        total += extra * nodes[3].by_compression;
                }
            }
            if (first) {
                for (int i = 0; i < RATES; i++)
                    own[i] = total;
            } else if (is_moved) {
                advance(own, step.moments, parts_of);
                if (start != 0.0 || stop != 0.0)
                    for (int i = 0; i < RATES; i++)
                        own[i] += start * step.at_begin[i] + stop * step.at_end[i];
            } else if (is_kept) {
                for (int i = 0; i < RATES; i++)
                    own[i] *= given[i];
            }
            moved[k + 1] = now;
            lifted[k + 1] = raised;
            totals[k + 1] = total;
            jacobian[(size_t)n * columns + k] = column;
        }
        last[0] = c1;
        last[1] = f1;
        last[2] = is_on;
        last[3] = force;
    }
    return 0;
}

/* How far loading and its age go on a logarithmic scale in each block: see loops.py. */
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

/* Whiten rows by a Kalman filter of two random walks: see loops.py. */
double fden_whiten(int blocks, int rows, double *values, const double *noise,
                   const double *gain, const double *walk, const double *motion, double *state,
                   double *means)
{
    double p00 = state[0], p01 = state[1], p11 = state[2], log_determinant = 0.0;
    for (int n = 0; n < blocks; n++) {
        double h = gain[n];
        p00 += walk[n];
        p11 += motion[n];
        double a = p00 + h * p01, b = p01 + h * p11;
        double s = a + h * b + noise[n], root = 1.0 / sqrt(s), ka = a / s, kb = b / s;
        double *row = values + (size_t)n * rows;
        for (int k = 0; k < rows; k++) {
            double e = row[k] - means[k] - h * means[rows + k];
            means[k] += ka * e;
            means[rows + k] += kb * e;
            row[k] = e * root;
        }
        p00 -= ka * a;
        p01 -= ka * b;
        p11 -= kb * b;
        log_determinant += log(s);
    }
    state[0] = p00;
    state[1] = p01;
    state[2] = p11;
    return log_determinant;
}

/* Cholesky's elimination of symmetric systems: see loops.py. Returns 1 where one is not positive
 * definite. */
CLONED int fden_eliminate(int count, int size, int columns, double *systems)
{
    for (int m = 0; m < count; m++) {
        double *rows = systems + (size_t)m * size * columns;
        for (int k = 0; k < size; k++) {
            double *pivot = rows + (size_t)k * columns;
            if (!(pivot[k] > 0.0))
                return 1;
            double unit = 1.0 / sqrt(pivot[k]);
            for (int j = k; j < columns; j++)
                pivot[j] *= unit;
            for (int i = k + 1; i < size; i++) {
                double *row = rows + (size_t)i * columns, part = pivot[i];
                for (int j = i; j < columns; j++)
                    row[j] -= part * pivot[j];
            }
        }
    }
    return 0;
}
