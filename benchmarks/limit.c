/* The limit: what the machine can do with the arithmetic of two methods, written by hand for its vector units.

   LIEMID[EA] (the paper's flight) and SYMMETRIC[EA] (Verlet with the exact flight of a body with two equal moments)
   for heavy tops, V = WEIGHT (R e3).z, with the equations and polynomials of midlie_jax. GCC's vector extensions:
   a `vec` is as many registers wide as are worth having in flight. A top's seven numbers never leave them, so not
   one pass over memory is made. LIEMID takes the same Newton steps as the package, whatever the turn; LIEMID-EARLY stops
   when its own lanes have settled, which no program can that runs one loop over a batch without a branch.

       python benchmarks/limit.py     writes limit.h (polynomials), builds this and runs it
       ./limit METHOD BODIES STEPS    prints the median seconds a body-step of five runs, and the first momentum */

#include <math.h>
#include <omp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "limit.h" /* REAL, INTEGER, VECTORS, EPSILON, FIRST, MORE; ARCTANGENT, ROUGH_ARCTANGENT, COSINE, SINE: lowest first */

typedef REAL vec __attribute__((vector_size(32 * VECTORS)));
typedef INTEGER mask __attribute__((vector_size(32 * VECTORS)));
#define LANES ((int)(sizeof(vec) / sizeof(REAL)))
#define INLINE static inline __attribute__((always_inline))

typedef struct { vec x, y, z; } vec3;
typedef struct { vec w, x, y, z; } quat;
typedef struct { vec3 p; quat q; } top;

#define COUNT(table) ((int)(sizeof(table) / sizeof(*table)))
static const REAL MOMENTS[3] = {5, 5, 1}, WEIGHT = 20, DT = .005;

INLINE vec polynomial(const REAL *c, int n, vec x) { /* Estrin: pairs, then pairs of pairs */
    vec term[16];
    for (int i = 0; i < n / 2; i++) term[i] = c[2 * i] + c[2 * i + 1] * x;
    if (n % 2) term[n / 2] = 0 * x + c[n - 1];
    for (n = (n + 1) / 2; n > 1; n = (n + 1) / 2) {
        x = x * x;
        for (int i = 0; i < n / 2; i++) term[i] = term[2 * i] + term[2 * i + 1] * x;
        if (n % 2) term[n / 2] = term[n - 1];
    }
    return term[0];
}
#define POLYNOMIAL(table, x) polynomial(table, COUNT(table), x)

INLINE vec dot(vec3 a, vec3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
INLINE vec3 cross(vec3 a, vec3 b) {
    return (vec3){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
INLINE vec3 axpy(vec c, vec3 a, vec3 b) { return (vec3){c * a.x + b.x, c * a.y + b.y, c * a.z + b.z}; }
INLINE quat multiply(quat a, quat b) {
    return (quat){a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z, a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
                  a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x, a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w};
}
INLINE vec3 rotate_back(quat q, vec3 v) {
    vec3 u = {-q.x, -q.y, -q.z}, t = cross(u, v);
    t = (vec3){2 * t.x, 2 * t.y, 2 * t.z};
    return axpy(q.w, t, (vec3){0 * v.x + v.x + cross(u, t).x, v.y + cross(u, t).y, v.z + cross(u, t).z});
}
INLINE quat unit(quat q) { /* Newton's step towards length one */
    vec f = (REAL)1.5 - (REAL).5 * (q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z);
    return (quat){f * q.w, f * q.x, f * q.y, f * q.z};
}
INLINE int any(mask m) {
    for (int i = 0; i < LANES; i++)
        if (m[i]) return 1;
    return 0;
}

typedef struct { vec3 a, b, c; vec factor; } inverse; /* rows of the adjugate, one over the determinant */
INLINE inverse invert(vec3 a, vec3 b, vec3 c) {
    inverse m = {cross(b, c), cross(c, a), cross(a, b), a.x};
    m.factor = 1 / dot(a, m.a);
    return m;
}
INLINE vec3 apply(inverse m, vec3 v) {
    return (vec3){m.factor * dot(m.a, v), m.factor * dot(m.b, v), m.factor * dot(m.c, v)};
}

/* LIEMID: g (v + u x v) = y - u x y, v = 4 I u, g = atan|u|/|u|, y = h Pi; as in midlie_jax/flights/lie_midpoint.py */
INLINE vec3 residual(const REAL *k, vec3 y, vec3 u, int exact) {
    vec x = dot(u, u), g = exact ? POLYNOMIAL(ARCTANGENT, x) : POLYNOMIAL(ROUGH_ARCTANGENT, x);
    vec3 v = {g * (k[0] * u.x), g * (k[1] * u.y), g * (k[2] * u.z)};
    vec3 turned = cross(u, (vec3){v.x + y.x, v.y + y.y, v.z + y.z});
    return (vec3){v.x - y.x + turned.x, v.y - y.y + turned.y, v.z - y.z + turned.z};
}
INLINE void plain(vec k0, vec k1, vec k2, vec3 y, vec3 u, vec3 *c) { /* columns of K + [u] K - [K u] - [y] */
    vec a = k0 * u.x + y.x, b = k1 * u.y + y.y, d = k2 * u.z + y.z;
    c[0] = (vec3){k0, k0 * u.z - d, b - k0 * u.y};
    c[1] = (vec3){d - k1 * u.z, k1, k1 * u.x - a};
    c[2] = (vec3){k2 * u.y - b, a - k2 * u.x, k2};
}
INLINE inverse jacobian(const REAL *four, vec3 y, vec3 u) {
    vec x = dot(u, u), g = POLYNOMIAL(ROUGH_ARCTANGENT, x), slope = 2 * POLYNOMIAL(ROUGH_SLOPE, x);
    vec3 v = {four[0] * u.x, four[1] * u.y, four[2] * u.z}, l = cross(u, v), c[3];
    l = (vec3){slope * (v.x + l.x), slope * (v.y + l.y), slope * (v.z + l.z)};
    plain(four[0] * g, four[1] * g, four[2] * g, y, u, c);
    return invert(axpy(u.x, l, c[0]), axpy(u.y, l, c[1]), axpy(u.z, l, c[2]));
}
INLINE vec improve(inverse m, const REAL *k, vec3 y, vec3 *u, int exact) { /* returns |residual|^2 before */
    vec3 r = residual(k, y, *u, exact), change = apply(m, r);
    *u = (vec3){u->x - change.x, u->y - change.y, u->z - change.z};
    return dot(r, r);
}
INLINE void fly_liemid(top *s, REAL h, int early) {
    const REAL k[3] = {4 * MOMENTS[0], 4 * MOMENTS[1], 4 * MOMENTS[2]}, limit = 8 * EPSILON;
    vec3 y = {h * s->p.x, h * s->p.y, h * s->p.z}, twice = {2 * y.x, 2 * y.y, 2 * y.z}, c[3];
    vec3 u = {0 * y.x, 0 * y.x, 0 * y.x};
    plain(k[0] + u.x, k[1] + u.x, k[2] + u.x, twice, u, c);
    u = apply(invert(c[0], c[1], c[2]), y);
    plain(k[0] + 0 * y.x, k[1] + 0 * y.x, k[2] + 0 * y.x, y, u, c);
    inverse m = invert(c[0], c[1], c[2]);
    for (int i = 0; i < (early ? 1 : FIRST); i++) improve(m, k, y, &u, 0);
    if (early)
        for (int pair = 0; pair < 6; pair++) {
            m = jacobian(k, y, u);
            vec before = improve(m, k, y, &u, 1), between = improve(m, k, y, &u, 1);
            if (!any(between * between > limit * limit * before * dot(y, y))) break;
        }
    else
        for (int round = 0; round < COUNT(MORE); round++) {
            m = jacobian(k, y, u);
            for (int i = 0; i < MORE[round]; i++) improve(m, k, y, &u, round == COUNT(MORE) - 1);
        }
    vec x = dot(u, u), share = 1 / (1 + x);
    quat turn = {(1 - x) * share, 2 * share * u.x, 2 * share * u.y, 2 * share * u.z};
    s->p = rotate_back(turn, s->p);
    s->q = multiply(s->q, turn);
}

/* SYMMETRIC: exp(h Pi/I1) exp(b e3), b = h (1/I3 - 1/I1) Pi3; as in midlie_jax/flights/symmetric.py */
INLINE void fly_symmetric(top *s, REAL h, int early) {
    (void)early;
    REAL per = 1 / MOMENTS[0];
    vec3 w = {h / 2 * per * s->p.x, h / 2 * per * s->p.y, h / 2 * per * s->p.z};
    vec b = h / 2 * (1 / MOMENTS[2] - per) * s->p.z, x = dot(w, w);
    vec sine = POLYNOMIAL(SINE, x);
    quat whole = {POLYNOMIAL(COSINE, x), sine * w.x, sine * w.y, sine * w.z};
    vec c = POLYNOMIAL(SPIN_COSINE, b * b), d = b * POLYNOMIAL(SPIN_SINE, b * b);
    whole = multiply(whole, whole);
    s->q = multiply(s->q, (quat){whole.w * c - whole.z * d, whole.x * c + whole.y * d, whole.y * c - whole.x * d,
                                 whole.w * d + whole.z * c});
    x = c * c - d * d, d = 2 * c * d;
    s->p = (vec3){x * s->p.x + d * s->p.y, x * s->p.y - d * s->p.x, s->p.z};
}

INLINE void run(top *s, int steps, int flights, void (*fly)(top *, REAL, int), int early) {
    vec tx = 2 * WEIGHT * (s->q.y * s->q.z + s->q.w * s->q.x), ty = -2 * WEIGHT * (s->q.x * s->q.z - s->q.w * s->q.y);
    for (int n = 0; n < steps; n++) {
        s->p.x += DT / 2 * tx, s->p.y += DT / 2 * ty;
        for (int i = 0; i < flights; i++) fly(s, DT / flights, early);
        s->q = unit(s->q);
        tx = 2 * WEIGHT * (s->q.y * s->q.z + s->q.w * s->q.x), ty = -2 * WEIGHT * (s->q.x * s->q.z - s->q.w * s->q.y);
        s->p.x += DT / 2 * tx, s->p.y += DT / 2 * ty;
    }
}

static int ascending(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Seconds: of the processor on one thread, of the wall on several, as in midlie_jax/timing.py. */
static double now(void) {
    struct timespec t;
    clock_gettime(omp_get_max_threads() == 1 ? CLOCK_PROCESS_CPUTIME_ID : CLOCK_MONOTONIC, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}

int main(int count, char **words) {
    if (count != 4) return fprintf(stderr, "usage: limit LIEMID|LIEMID-EARLY|SYMMETRIC BODIES STEPS\n"), 2;
    int liemid = !strncmp(words[1], "LIEMID", 6), early = !strcmp(words[1], "LIEMID-EARLY"), groups = atoi(words[2]) / LANES, steps = atoi(words[3]);
    if (!liemid && strcmp(words[1], "SYMMETRIC")) return fprintf(stderr, "no limit for %s\n", words[1]), 2;
    double seconds[5];
    top *tops = aligned_alloc(64, groups * sizeof(top));
    for (int repeat = 0; repeat < 5; repeat++) {
        for (int i = 0; i < groups; i++) { /* the fast top P1, its spin varied a little from lane to lane */
            memset(&tops[i], 0, sizeof(top));
            tops[i].p.z += 50, tops[i].q.w += (REAL)cos(.025), tops[i].q.x += (REAL)sin(.025);
            for (int lane = 0; lane < LANES; lane++) tops[i].p.z[lane] += (REAL)1e-3 * (i * LANES + lane) / (groups * LANES);
        }
        double begin = now();
#pragma omp parallel for schedule(static)
        for (int i = 0; i < groups; i++)
            if (early) run(&tops[i], steps, 2, fly_liemid, 1);
            else if (liemid) run(&tops[i], steps, 2, fly_liemid, 0);
            else run(&tops[i], steps, 1, fly_symmetric, 0);
        seconds[repeat] = now() - begin;
    }
    qsort(seconds, 5, sizeof(double), ascending);
    printf("%.6e %.15e %.15e %.15e\n", seconds[2] / ((double)groups * LANES * steps), (double)tops[0].p.x[0],
           (double)tops[0].p.y[0], (double)tops[0].p.z[0]);
    free(tops);
}
