/* SPDX-FileCopyrightText: 2026 fden_ros maintainers
 * SPDX-License-Identifier: Apache-2.0
 *
 * The compiled loops of the posterior. No Python in them but for module.c; names and equations are
 * explained in loops.py.
 */

#ifndef FDEN_LOOPS_H
#define FDEN_LOOPS_H

#include <stddef.h>
#include <stdint.h>

/* Compiled for each width of vector; which one runs is seen at its first call. */
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__)
#define CLONED __attribute__((target_clones("avx512f", "avx2", "default")))
#else
#define CLONED
#endif
#define INLINE inline __attribute__((always_inline))

#define RATES 32
#define TERMS 5
/* Sums and columns go in groups of eight, whatever the width of the vectors. */
#define GROUP 8

/* What of the law a column is the derivative by. */
enum { BY_NOTHING, BY_LOG_G, BY_LOG_GN, BY_COMPLIANCE, BY_FIRST_KNOT };

typedef struct {
    double g, gn, power, one_sided, compliance, slow, fast;
    const double *series; /* TERMS of them: 1 + sum of c_k u^(k/2) raises the strain u^power */
    int knots;
    double last_knot;
    const double *bend;
} Law;

/* What a response is a function of, and where it goes. */
typedef struct {
    Law law;
    int points, blocks, columns, moving, is_begun;
    const double *moments, *durations, *rates, *compressions, *surface, *weights;
    const int64_t *kinds, *weight_of, *first, *last;
    const double *motions, *surfaces, *weight_changes;
    double *state;
    double *stress, *jacobian; /* of the blocks */
    double *elastics, *slopes; /* of the points */
} Response;

void fden_moments(int steps, const double *durations, const double *rates, double *moments);
/* Returns 0, or 1 where something is not finite. */
int fden_response(const Response *in);

/* Of a press at one state. */
typedef struct {
    int points, blocks;
    const double *elastic, *slope, *stress;
    const int64_t *first, *last, *met;
    const double *counts, *durations, *middles, *steps, *bends;
    double stress_variance, compression_sd, order, factor, drift, motion, surface_factor;
    double corner, shortest, floor, youngest;
    double *loading;                                 /* time, elastic response, age */
    double *noise, *gain, *rough, *drifts, *motions; /* of the blocks */
} ErrorsOf;

void fden_errors(const ErrorsOf *in);
void fden_clock(int blocks, const double *loaded, const double *seconds, double floor,
                double *state, double *clock);

/* Two random walks and what they are seen by. */
typedef struct {
    int blocks;
    const double *noise, *gain, *rough, *drift, *motion;
    double roughness, surface; /* squares of the scales */
    double *covariance;        /* of the stress's walk, of both, of the surface's */
} Walks;

double fden_whiten(const Walks *walks, int columns, double *rows, double *means);
double fden_equations(const Walks *walks, int columns, double *rows, double *means, double *normal);

/* Blocks that a filter takes, linear about a state of so many unknowns. */
typedef struct {
    Walks walks;
    int unknowns;
    const double *observed, *predicted, *jacobian, *about, *free; /* free: 0 of what is known, else 1 */
} Followed;

/* Bring mean and covariance of the unknowns and the walks through blocks; `found`: prediction,
 * innovation and its variance of the last, and the log likelihood of all. Returns 1 where one is not
 * finite. */
int fden_follow(const Followed *in, double *mean, double *covariance, double *found);

/* Normal equations whose prior depends on two scales. */
typedef struct {
    int size, held, kernel, characteristic; /* held: a bit a place; and where the errors begin */
    const double *normal, *towards, *base, *off, *kernel_prior, *characteristic_prior;
} Scaled;

/* Each returns 1 where a matrix is not positive definite. */
int fden_weigh(const Scaled *in, int places, const double *scales, double *gains);
int fden_mix(const Scaled *in, int places, const double *scales, const double *weights,
             double *mean, double *second);
int fden_solve(int size, const double *matrix, const double *side, double *found);

#endif
