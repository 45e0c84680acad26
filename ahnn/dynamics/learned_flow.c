/* Steps along learned Hamiltonians in double: the formulas are those of energies.py, inputs.py, explicit.py and
   symplectic.py, which are the reference. MEMBERS states are processed side by side: an array with n numbers for
   each state has n rows of MEMBERS. Matrices are padded with zeros to a multiple of ROWS rows. */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lanes.h"
#include "products.h"

enum { MEMBERS = 16 };
enum { AFFINE, ISOTROPIC, RADIAL };
enum { DONE, NO_MEMORY };

#define ROW(array, i) ((array) + (i) * MEMBERS)
#define MEMBER(m) for (long m = 0; m < MEMBERS; m++)

/* unit (R / r)^falloff N(z), where R is `nearest` and z contains the mapped coordinates, and `straight` others that
   are only shifted and scaled. */
typedef struct {
    long map, mapped, straight, inputs, width, depth, activation;
    const real *up, *down, *bias, *last, *shift, *scale;
    real offset, unit, falloff, nearest, middle, spread;
} energy;

/* A Hamiltonian and its integrator. The Hamiltonian is `whole`, or else the sum of a kinetic energy, p^2 / 2 mass if
   it has no network, and a potential energy, to which -central / r is added. The table contains the stages of a
   Runge-Kutta method, then its weights; or, if `kicks` > 0, the drifts of a composition, then its kicks. */
typedef struct {
    long dof, stages, kicks;
    const energy *whole, *kinetic, *potential;
    const real *mass, *table;
    real central;
} motion;

/* Memory for the layers of a network. */
typedef struct {
    real *z, *values, *slopes, *delta, *u, *g;
} layers;

static const real NOTHING[MEMBERS] __attribute__((aligned(64))) = {0};

INLINE long rows_of(const energy *of) { return filled(of->width, ROWS); }

/* Write N(z) to `value`, and dN/dz to the rows of `g`. */
static void network(const energy *of, const layers *at, real *value) {
    long rows = rows_of(of), block = rows * MEMBERS, inputs = of->inputs;
    const real *entered = at->z, *up = of->up;
    for (long k = 0; k < of->depth; k++, up += rows * inputs, inputs = of->width) {
        real *values = at->values + k * block, *slopes = at->slopes + k * block;
        product(up, inputs, 1, entered, MEMBERS, rows, inputs, of->bias + k * block, MEMBERS, at->u);
        EACH(i, block) {
            point here = activated(of->activation, AT(at->u, i));
            AT(values, i) = here.value, AT(slopes, i) = here.slope;
        }
        entered = values;
    }
    MEMBER(m) value[m] = of->offset;
    for (long i = 0; i < of->width; i++) {
        const real *slope = at->slopes + (of->depth - 1) * block;
        MEMBER(m) value[m] += of->last[i] * ROW(entered, i)[m];
        MEMBER(m) ROW(at->delta, i)[m] = of->last[i] * ROW(slope, i)[m];
    }
    const real *down = of->down;
    for (long k = of->depth - 1; k > 0; k--, down += rows * of->width) {
        const real *slopes = at->slopes + (k - 1) * block;
        product(down, of->width, 1, at->delta, MEMBERS, rows, of->width, NOTHING, 0, at->u);
        EACH(i, of->width * MEMBERS) AT(at->delta, i) = AT(at->u, i) * AT(slopes, i);
    }
    product(down, of->width, 1, at->delta, MEMBERS, filled(of->inputs, ROWS), of->width, NOTHING, 0, at->g);
}

/* Sum the squares of n rows. */
static void squares(const real *q, long n, real *square) {
    MEMBER(m) square[m] = 0;
    for (long i = 0; i < n; i++) MEMBER(m) square[m] += ROW(q, i)[m] * ROW(q, i)[m];
}

/* Write the gradient of an energy with respect to the mapped coordinates q to `to`, and with respect to `others`, the
   `straight` coordinates, to `to_others`. */
static void gradient(const energy *of, const real *q, const real *others, const layers *at, real *to, real *to_others) {
    long n = of->mapped, first = of->inputs - of->straight;
    real square[MEMBERS], r[MEMBERS], value[MEMBERS], along[MEMBERS];
    squares(q, n, square);
    MEMBER(m) r[m] = sqrt(square[m]);
    if (of->map == AFFINE)
        for (long i = 0; i < n; i++) MEMBER(m) ROW(at->z, i)[m] = (ROW(q, i)[m] - of->shift[i]) / of->scale[i];
    if (of->map == ISOTROPIC)
        for (long i = 0; i < n; i++) MEMBER(m) ROW(at->z, i)[m] = ROW(q, i)[m] / r[m];
    if (of->map != AFFINE) MEMBER(m) ROW(at->z, first - 1)[m] = (log(r[m]) - of->middle) / of->spread;
    const real *shift = of->shift + n, *scale = of->scale + n;
    for (long i = 0; i < of->straight; i++)
        MEMBER(m) ROW(at->z, first + i)[m] = (ROW(others, i)[m] - shift[i]) / scale[i];
    network(of, at, value);
    for (long i = 0; i < of->straight; i++)
        MEMBER(m) ROW(to_others, i)[m] = of->unit * ROW(at->g, first + i)[m] / scale[i];
    if (of->map != AFFINE) MEMBER(m) along[m] = ROW(at->g, first - 1)[m] / of->spread;
    if (of->map == ISOTROPIC)
        for (long i = 0; i < n; i++) MEMBER(m) along[m] -= ROW(at->z, i)[m] * ROW(at->g, i)[m];
    real weight[MEMBERS];
    MEMBER(m) weight[m] = of->unit;
    if (of->falloff != 0)
        MEMBER(m) weight[m] *= pow(of->nearest * of->nearest / square[m], of->falloff / 2);
    for (long i = 0; i < n; i++) {
        real *own = ROW(to, i);
        const real *g = ROW(at->g, i), *z = ROW(at->z, i), *x = ROW(q, i);
        if (of->map == AFFINE) MEMBER(m) own[m] = g[m] / of->scale[i];
        if (of->map == ISOTROPIC) MEMBER(m) own[m] = (g[m] + along[m] * z[m]) / r[m];
        if (of->map == RADIAL) MEMBER(m) own[m] = along[m] / square[m] * x[m];
        if (of->falloff != 0) MEMBER(m) own[m] -= x[m] * of->falloff / square[m] * value[m];
        MEMBER(m) own[m] *= weight[m];
    }
}

/* dq/dt as a function of momenta. */
static void velocity(const motion *of, const real *p, const layers *at, real *to) {
    if (of->kinetic) gradient(of->kinetic, p, NULL, at, to, NULL);
    else for (long i = 0; i < of->dof; i++) MEMBER(m) ROW(to, i)[m] = ROW(p, i)[m] / of->mass[i];
}

/* dp/dt as a function of positions. */
static void force(const motion *of, const real *q, const layers *at, real *to) {
    real square[MEMBERS];
    gradient(of->potential, q, NULL, at, to, NULL);
    squares(q, of->dof, square);
    for (long i = 0; i < of->dof; i++) {
        if (of->central != 0) MEMBER(m) ROW(to, i)[m] += of->central / (square[m] * sqrt(square[m])) * ROW(q, i)[m];
        MEMBER(m) ROW(to, i)[m] = -ROW(to, i)[m];
    }
}

/* dx/dt as a function of states. */
static void field(const motion *of, const real *x, const layers *at, real *to) {
    long half = of->dof * MEMBERS;
    if (!of->whole) {
        velocity(of, x + half, at, to);
        force(of, x, at, to + half);
        return;
    }
    gradient(of->whole, x, x + half, at, to + half, to);
    EACH(i, half) AT(to + half, i) = -AT(to + half, i);
}

/* to = x + h sum_k weights[k] rows_k, where each of the rows has `length` numbers. */
static void moved(const real *x, real h, const real *weights, long count, const real *rows, long length, real *to) {
    EACH(i, length) {
        lanes sum = {};
        for (long k = 0; k < count; k++)
            if (weights[k] != 0) sum += weights[k] * AT(rows, k * length + i);
        AT(to, i) = AT(x, i) + h * sum;
    }
}

/* Write the states after a Runge-Kutta step h. */
static void runge_kutta(const motion *of, real h, const layers *at, const real *x, real *here, real *slopes, real *out) {
    long length = 2 * of->dof * MEMBERS, count = of->stages;
    for (long k = 0; k < count; k++) {
        moved(x, h, of->table + k * count, k, slopes, length, here);
        field(of, here, at, slopes + k * length);
    }
    moved(x, h, of->table + count * count, count, slopes, length, out);
}

/* Write the states after a step h of a composition of leapfrogs that begins with a drift. */
static void composition(const motion *of, real h, const layers *at, const real *x, real *here, real *slopes, real *out) {
    long half = of->dof * MEMBERS;
    const real *drifts = of->table, *kicks = drifts + of->kicks + 1, *p = x + half;
    real *dq = slopes, *dp = slopes + half, *rate = slopes + 2 * half;
    memset(slopes, 0, sizeof(real) * (size_t)(2 * half));
    for (long k = 0; k <= of->kicks; k++) {
        EACH(i, half) AT(here, i) = AT(p, i) + AT(dp, i);
        velocity(of, here, at, rate);
        EACH(i, half) AT(dq, i) += drifts[k] * h * AT(rate, i);
        if (k == of->kicks) break;
        EACH(i, half) AT(here, i) = AT(x, i) + AT(dq, i);
        force(of, here, at, rate);
        EACH(i, half) AT(dp, i) += kicks[k] * h * AT(rate, i);
    }
    EACH(i, 2 * half) AT(out, i) = AT(x, i) + AT(slopes, i);
}

/* Reserve memory for the largest network of a motion. */
static layers laid(arena *from, const motion *of) {
    long rows = 0, inputs = 0, depth = 0;
    const energy *all[] = {of->whole, of->kinetic, of->potential};
    for (int k = 0; k < 3; k++) {
        if (!all[k]) continue;
        rows = rows > rows_of(all[k]) ? rows : rows_of(all[k]);
        inputs = inputs > all[k]->inputs ? inputs : all[k]->inputs;
        depth = depth > all[k]->depth ? depth : all[k]->depth;
    }
    long block = rows * MEMBERS, wide = filled(inputs, ROWS) * MEMBERS;
    layers at = {.z = take(from, wide), .values = take(from, depth * block), .slopes = take(from, depth * block)};
    at.delta = take(from, block), at.u = take(from, block), at.g = take(from, wide);
    return at;
}

/* Write the states (count, 2 dof) at a time dt after the states x. */
long ahnn_learned_flow(const motion *of, long count, const double *x, double dt, double *out) {
    long size = 2 * of->dof, length = size * MEMBERS;
    arena from = {NULL, 0};
    real *room[4];
    layers at;
    for (int pass = 0; pass < 2; pass++) { /* first count the memory, then allocate it */
        if (pass) from = (arena){aligned_alloc(64, filled((long)(sizeof(real) * from.used), 64)), 0};
        if (pass && !from.base) return NO_MEMORY;
        at = laid(&from, of);
        for (int k = 0; k < 3; k++) room[k] = take(&from, length);
        room[3] = take(&from, (of->stages + 2) * length);
    }
    for (long first = 0; first < count; first += MEMBERS) {
        for (long d = 0; d < size; d++) /* an incomplete block is filled with copies of the last state */
            MEMBER(m) ROW(room[0], d)[m] = x[size * (first + m < count ? first + m : count - 1) + d];
        if (of->kicks) composition(of, dt, &at, room[0], room[1], room[3], room[2]);
        else runge_kutta(of, dt, &at, room[0], room[1], room[3], room[2]);
        for (long m = 0; m < MEMBERS && first + m < count; m++)
            for (long d = 0; d < size; d++) out[size * (first + m) + d] = ROW(room[2], d)[m];
    }
    free(from.base);
    return DONE;
}
