/* SPDX-FileCopyrightText: 2026 fden_ros maintainers
 * SPDX-License-Identifier: Apache-2.0
 *
 * The compiled loops as a Python module. Arrays come as contiguous buffers of float64, or int64
 * where they count; a wrong kind or size is refused. The interpreter's lock is released meanwhile.
 */

#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include "loops.h"

/* Raised with every change of what a function takes: loops.py compares it. */
#define VERSION 5

#define MOST_ARGUMENTS 32

/* The arguments of a call, read one after the other. */
typedef struct {
    PyObject *const *arguments;
    Py_ssize_t count, next;
    Py_buffer views[MOST_ARGUMENTS];
    int open, has_failed;
} Call;

static Call begin(PyObject *const *arguments, Py_ssize_t count)
{
    Call call = {arguments, count, 0, {{0}}, 0, 0};
    return call;
}

static PyObject *take(Call *call)
{
    if (call->has_failed)
        return NULL;
    if (call->next >= call->count) {
        PyErr_SetString(PyExc_TypeError, "the compiled loops miss an argument");
        call->has_failed = 1;
        return NULL;
    }
    return call->arguments[call->next++];
}

/* The next argument as an array of at least so many numbers. */
static void *array(Call *call, char kind, Py_ssize_t least, Py_ssize_t *size)
{
    PyObject *argument = take(call);
    if (!argument)
        return NULL;
    if (call->open == MOST_ARGUMENTS) {
        PyErr_SetString(PyExc_TypeError, "the compiled loops have too many arguments");
        call->has_failed = 1;
        return NULL;
    }
    Py_buffer *view = &call->views[call->open];
    if (PyObject_GetBuffer(argument, view, PyBUF_C_CONTIGUOUS | PyBUF_FORMAT) < 0) {
        call->has_failed = 1;
        return NULL;
    }
    call->open++;
    char format = view->format ? view->format[0] : 'B';
    int is_right = kind == 'd' ? format == 'd' : (format == 'l' || format == 'q');
    Py_ssize_t found = view->itemsize == 8 ? view->len / 8 : -1;
    if (!is_right || found < least) {
        PyErr_Format(PyExc_ValueError,
                     "argument %zd of the compiled loops is no contiguous array of %s, %zd of them",
                     call->next, kind == 'd' ? "float64" : "int64", least);
        call->has_failed = 1;
        return NULL;
    }
    if (size)
        *size = found;
    return view->buf;
}

static double *numbers(Call *call, Py_ssize_t least)
{
    return array(call, 'd', least, NULL);
}

/* None stands for no array. */
static double *numbers_or_none(Call *call, Py_ssize_t least)
{
    if (call->next < call->count && call->arguments[call->next] == Py_None) {
        call->next++;
        return NULL;
    }
    return array(call, 'd', least, NULL);
}

static double *sized(Call *call, Py_ssize_t *size)
{
    return array(call, 'd', 0, size);
}

static int64_t *places(Call *call, Py_ssize_t least)
{
    return array(call, 'q', least, NULL);
}

static int64_t *sized_places(Call *call, Py_ssize_t *size)
{
    return array(call, 'q', 0, size);
}

static double number(Call *call)
{
    PyObject *argument = take(call);
    double found = argument ? PyFloat_AsDouble(argument) : 0.0;
    call->has_failed |= argument && found == -1.0 && PyErr_Occurred();
    return found;
}

static int integer(Call *call)
{
    PyObject *argument = take(call);
    long found = argument ? PyLong_AsLong(argument) : 0;
    call->has_failed |= argument && found == -1 && PyErr_Occurred();
    return (int)found;
}

static int is_ready(Call *call)
{
    if (!call->has_failed && call->next != call->count) {
        PyErr_SetString(PyExc_TypeError, "the compiled loops have too many arguments");
        call->has_failed = 1;
    }
    return !call->has_failed;
}

static void end(Call *call)
{
    while (call->open)
        PyBuffer_Release(&call->views[--call->open]);
}

#define FUNCTION(name)                                                                            \
    static PyObject *name(PyObject *module, PyObject *const *arguments, Py_ssize_t count)

/* (durations, rates, moments) */
FUNCTION(moments)
{
    Call call = begin(arguments, count);
    Py_ssize_t steps = 0;
    const double *durations = sized(&call, &steps), *rates = numbers(&call, RATES);
    double *found = numbers(&call, steps * 4 * RATES);
    if (is_ready(&call)) {
        Py_BEGIN_ALLOW_THREADS
        fden_moments((int)steps, durations, rates, found);
        Py_END_ALLOW_THREADS
    }
    end(&call);
    if (call.has_failed)
        return NULL;
    Py_RETURN_NONE;
}

/* (law, bend, weights, rates, durations, moments, compressions, surface, kinds, motions, surfaces,
 * weight_of, weight_changes, first, last, state, is_begun, stress, jacobian, elastics, slopes):
 * whether all is finite */
FUNCTION(respond)
{
    Call call = begin(arguments, count);
    Response in;
    Py_ssize_t knots = 0, points = 0, columns = 0, motions = 0, rows = 0, blocks = 0;
    const double *law = numbers(&call, 8 + TERMS), *bend = sized(&call, &knots);
    in.weights = numbers(&call, RATES + 2);
    in.rates = numbers(&call, RATES);
    in.durations = sized(&call, &points);
    in.moments = numbers(&call, points * 4 * RATES);
    in.compressions = numbers(&call, points);
    in.surface = numbers_or_none(&call, points);
    in.kinds = sized_places(&call, &columns);
    in.motions = sized(&call, &motions);
    in.surfaces = numbers_or_none(&call, columns * points);
    in.weight_of = places(&call, columns);
    in.weight_changes = sized(&call, &rows);
    in.first = sized_places(&call, &blocks);
    in.last = places(&call, blocks);
    in.state = numbers(&call, (columns + 1) * (RATES + 3) + 5);
    in.is_begun = integer(&call);
    in.stress = numbers(&call, blocks);
    in.jacobian = numbers(&call, blocks * columns);
    in.elastics = numbers(&call, points);
    in.slopes = numbers(&call, points);
    int failed = 1;
    if (is_ready(&call)) {
        in.points = (int)points, in.columns = (int)columns, in.blocks = (int)blocks;
        in.moving = points ? (int)(motions / points) : 0;
        Law own = {law[0], law[1], law[2], law[3], law[4], law[5], law[6], law + 8, (int)knots, law[7], bend};
        in.law = own;
        for (Py_ssize_t k = 0; k < columns; k++)
            call.has_failed |= in.weight_of[k] >= rows / (RATES + 2);
        if (in.moving > in.columns || call.has_failed || knots == 1 || knots == 2) {
            PyErr_SetString(PyExc_ValueError, "columns, motions and weights do not fit");
            call.has_failed = 1;
        } else {
            Py_BEGIN_ALLOW_THREADS
            failed = fden_response(&in);
            Py_END_ALLOW_THREADS
        }
    }
    end(&call);
    return call.has_failed ? NULL : PyBool_FromLong(!failed);
}

/* (elastic, slope, stress, first, last, met, counts, durations, middles, steps, bends,
 * numbers, loading, found): `numbers` in the order of loops.h, `found` rows of noise, gain, rough,
 * drifts and motions */
FUNCTION(errors)
{
    Call call = begin(arguments, count);
    ErrorsOf in;
    Py_ssize_t points = 0, blocks = 0;
    in.elastic = sized(&call, &points);
    in.slope = numbers(&call, points);
    in.stress = sized(&call, &blocks);
    in.first = places(&call, blocks);
    in.last = places(&call, blocks);
    in.met = places(&call, blocks);
    in.counts = numbers(&call, blocks);
    in.durations = numbers(&call, blocks);
    in.middles = numbers(&call, blocks);
    in.steps = numbers(&call, points);
    in.bends = numbers(&call, points);
    const double *given = numbers(&call, 11);
    in.loading = numbers(&call, 3);
    double *found = numbers(&call, 5 * blocks);
    if (is_ready(&call)) {
        in.points = (int)points, in.blocks = (int)blocks;
        in.stress_variance = given[0], in.compression_sd = given[1], in.order = given[2];
        in.factor = given[3], in.drift = given[4], in.motion = given[5];
        in.surface_factor = given[6], in.corner = given[7], in.shortest = given[8];
        in.floor = given[9], in.youngest = given[10];
        in.noise = found, in.gain = found + blocks, in.rough = found + 2 * blocks;
        in.drifts = found + 3 * blocks, in.motions = found + 4 * blocks;
        Py_BEGIN_ALLOW_THREADS
        fden_errors(&in);
        Py_END_ALLOW_THREADS
    }
    end(&call);
    if (call.has_failed)
        return NULL;
    Py_RETURN_NONE;
}

/* (loaded, seconds, floor, state, clock) */
FUNCTION(clock_of)
{
    Call call = begin(arguments, count);
    Py_ssize_t blocks = 0;
    const double *loaded = sized(&call, &blocks), *seconds = numbers(&call, blocks);
    double floor = number(&call), *state = numbers(&call, 2), *found = numbers(&call, blocks);
    if (is_ready(&call))
        fden_clock((int)blocks, loaded, seconds, floor, state, found);
    end(&call);
    if (call.has_failed)
        return NULL;
    Py_RETURN_NONE;
}

static Walks walks_of(Call *call, Py_ssize_t *blocks)
{
    Walks found = {0};
    const double *errors = sized(call, blocks);
    *blocks /= 5;
    found.blocks = (int)*blocks;
    found.noise = errors, found.gain = errors + *blocks, found.rough = errors + 2 * *blocks;
    found.drift = errors + 3 * *blocks, found.motion = errors + 4 * *blocks;
    found.roughness = number(call), found.surface = number(call);
    found.roughness *= found.roughness, found.surface *= found.surface;
    return found;
}

/* (errors, roughness, motion, covariance, rows, means): ln |S| */
FUNCTION(whiten)
{
    Call call = begin(arguments, count);
    Py_ssize_t blocks = 0, size = 0;
    Walks walks = walks_of(&call, &blocks);
    walks.covariance = numbers(&call, 3);
    double *rows = sized(&call, &size), found = 0.0;
    Py_ssize_t columns = blocks ? size / blocks : 0;
    double *means = numbers(&call, 2 * columns);
    if (is_ready(&call)) {
        Py_BEGIN_ALLOW_THREADS
        found = fden_whiten(&walks, (int)columns, rows, means);
        Py_END_ALLOW_THREADS
    }
    end(&call);
    return call.has_failed ? NULL : PyFloat_FromDouble(found);
}

/* (errors, roughness, motion, covariance, rows, means, normal): ln |S| */
FUNCTION(equations)
{
    Call call = begin(arguments, count);
    Py_ssize_t blocks = 0, size = 0;
    Walks walks = walks_of(&call, &blocks);
    walks.covariance = numbers(&call, 3);
    double *rows = sized(&call, &size), found = 0.0;
    Py_ssize_t columns = blocks ? size / blocks : 0;
    double *means = numbers(&call, 2 * columns), *normal = numbers(&call, columns * columns);
    if (is_ready(&call)) {
        Py_BEGIN_ALLOW_THREADS
        found = fden_equations(&walks, (int)columns, rows, means, normal);
        Py_END_ALLOW_THREADS
    }
    end(&call);
    return call.has_failed ? NULL : PyFloat_FromDouble(found);
}

/* (errors, roughness, motion, observed, predicted, about, free, jacobian, mean, covariance, found):
 * whether all is finite */
FUNCTION(follow)
{
    Call call = begin(arguments, count);
    Followed in;
    Py_ssize_t blocks = 0, unknowns = 0;
    in.walks = walks_of(&call, &blocks);
    in.observed = numbers(&call, blocks);
    in.predicted = numbers(&call, blocks);
    in.about = sized(&call, &unknowns);
    in.free = numbers(&call, unknowns);
    in.jacobian = numbers(&call, blocks * unknowns);
    double *mean = numbers(&call, unknowns + 2);
    double *covariance = numbers(&call, (unknowns + 2) * (unknowns + 2));
    double *found = numbers(&call, 4);
    int failed = 1;
    if (is_ready(&call)) {
        in.unknowns = (int)unknowns;
        Py_BEGIN_ALLOW_THREADS
        failed = fden_follow(&in, mean, covariance, found);
        Py_END_ALLOW_THREADS
    }
    end(&call);
    return call.has_failed ? NULL : PyBool_FromLong(!failed);
}

static Scaled scaled_of(Call *call)
{
    Scaled found;
    Py_ssize_t size = 0;
    found.towards = sized(call, &size);
    found.size = (int)size;
    found.normal = numbers(call, size * size);
    found.base = numbers(call, size * size);
    found.off = numbers(call, size);
    found.kernel = integer(call), found.characteristic = integer(call);
    found.held = integer(call);
    Py_ssize_t kernel = found.characteristic - found.kernel, rest = size - found.characteristic;
    found.kernel_prior = numbers_or_none(call, kernel * kernel);
    found.characteristic_prior = numbers_or_none(call, rest * rest);
    if (!call->has_failed
        && (found.kernel < 0 || kernel < 0 || rest < 0 || found.held < 0
            || (found.characteristic < 31 && found.held >> found.characteristic))) {
        PyErr_SetString(PyExc_ValueError, "places of the errors do not fit");
        call->has_failed = 1;
    }
    return found;
}

/* (towards, normal, base, off, kernel, characteristic, held, kernel_prior, characteristic_prior,
 * scales, gains): whether all are positive definite */
FUNCTION(weigh)
{
    Call call = begin(arguments, count);
    Scaled in = scaled_of(&call);
    Py_ssize_t size = 0;
    const double *scales = sized(&call, &size);
    double *gains = numbers(&call, size / 2);
    int failed = 1;
    if (is_ready(&call)) {
        Py_BEGIN_ALLOW_THREADS
        failed = fden_weigh(&in, (int)(size / 2), scales, gains);
        Py_END_ALLOW_THREADS
    }
    end(&call);
    return call.has_failed ? NULL : PyBool_FromLong(!failed);
}

/* (as weigh, but for the last; weights, mean, second) */
FUNCTION(mix)
{
    Call call = begin(arguments, count);
    Scaled in = scaled_of(&call);
    Py_ssize_t size = 0;
    const double *scales = sized(&call, &size), *weights = numbers(&call, size / 2);
    double *mean = numbers(&call, in.size), *second = numbers(&call, in.size * in.size);
    int failed = 1;
    if (is_ready(&call)) {
        Py_BEGIN_ALLOW_THREADS
        failed = fden_mix(&in, (int)(size / 2), scales, weights, mean, second);
        Py_END_ALLOW_THREADS
    }
    end(&call);
    return call.has_failed ? NULL : PyBool_FromLong(!failed);
}

/* (side, matrix, found): whether it is positive definite */
FUNCTION(solve)
{
    Call call = begin(arguments, count);
    Py_ssize_t size = 0;
    const double *side = sized(&call, &size), *matrix = numbers(&call, size * size);
    double *found = numbers(&call, size);
    int failed = 1;
    if (is_ready(&call))
        failed = fden_solve((int)size, matrix, side, found);
    end(&call);
    return call.has_failed ? NULL : PyBool_FromLong(!failed);
}

#define METHOD(name, function) {name, (PyCFunction)(void (*)(void))function, METH_FASTCALL, NULL}

static PyMethodDef METHODS[] = {
    METHOD("moments", moments),     METHOD("respond", respond), METHOD("errors", errors),
    METHOD("clock", clock_of),      METHOD("whiten", whiten),   METHOD("equations", equations),
    METHOD("weigh", weigh),         METHOD("mix", mix),         METHOD("solve", solve),
    METHOD("follow", follow),
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef MODULE = {
    PyModuleDef_HEAD_INIT, "_loops", "The compiled loops of the posterior.", -1, METHODS,
    NULL, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__loops(void)
{
    PyObject *module = PyModule_Create(&MODULE);
    if (module && PyModule_AddIntConstant(module, "VERSION", VERSION) < 0) {
        Py_DECREF(module);
        return NULL;
    }
    return module;
}
