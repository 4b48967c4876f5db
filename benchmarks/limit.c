/* The limit: what the machine can do with the arithmetic of four methods, written by hand for its vector units.

   Heavy tops, V = weight (R e3).z, move by LIEMID[EA] (the paper's method), JACOBI[EA] (the exact flight of any body),
   SYMMETRIC[EA] (that of a body with two equal moments) or DOP853, with the equations and polynomials of midlie_jax.
   Left out are its checks (`ok`), its corrections for rounding in long runs, and what it computes for other cases.

   limit.py builds this in several forms and takes the fastest. The form is defined on the compiler's command line:

       METHOD           LIEMID, LIEMID_EARLY, JACOBI, SYMMETRIC or DOP853
       VECTORS          how many vector registers hold one number of a group of tops: 1, 2 or 4
       GROUPS           how many groups take each step in turn. With 1, a group's numbers stay in registers from step to
                        step. With more, they go through the nearest cache, and the processor can work at the next group
                        while the results of one are not there yet.
       HARDWARE_ROOTS   1: square roots and divisions of the machine; 0: Newton's steps, as in midlie_jax

   Whether the compiler may reorder sums is a choice as well. Reordered sums wait less for each other, but can need more
   registers than there are.

       ./limit BODIES STEPS DT I1 I2 I3 WEIGHT    prints the median seconds a body-step of five runs in processor time, and
                                                  the momentum of the first top at the end */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "limit_vectors.h"
#include "limit_top.h"
#include "limit_dop853.h"
#include "limit_jacobi.h"
#include "limit_liemid.h"
#include "limit_symmetric.h"

#define JOINED(a, b) a##b
#define STEP_OF(method) JOINED(step_, method)

static void run(const body *given, top *tops, int steps) {
    const body b = *given; /* a copy that no store to a top can change */
    top group[GROUPS];
    memcpy(group, tops, sizeof(group));
    for (int i = 0; i < GROUPS; i++) pull(&b, &group[i]);
    for (int n = 0; n < steps; n++)
        for (int i = 0; i < GROUPS; i++) STEP_OF(METHOD)(&b, &group[i]);
    memcpy(tops, group, sizeof(group));
}

/* The fast top P1, its spin varied a little from top to top. */
static void start(top *tops, int groups) {
    memset(tops, 0, groups * sizeof(top));
    for (int i = 0; i < groups; i++) {
        tops[i].p.z += 50, tops[i].q.w += (REAL)cos(.025), tops[i].q.x += (REAL)sin(.025);
        for (int lane = 0; lane < LANES; lane++) tops[i].p.z[lane] += (REAL)1e-3 * (i * LANES + lane) / (groups * LANES);
    }
}

static int ascending(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}

int main(int count, char **words) {
    if (count != 8) return fprintf(stderr, "usage: limit BODIES STEPS DT I1 I2 I3 WEIGHT\n"), 2;
    int per_turn = LANES * GROUPS, groups = (atoi(words[1]) + per_turn - 1) / per_turn * GROUPS, steps = atoi(words[2]);
    double moments[3] = {atof(words[4]), atof(words[5]), atof(words[6])}, seconds[5];
    body b = body_of(moments, atof(words[7]), atof(words[3]));
    top *tops = aligned_alloc(64, groups * sizeof(top));
    for (int repeat = 0; repeat < 5; repeat++) {
        start(tops, groups);
        double begin = now();
        for (int i = 0; i < groups; i += GROUPS) run(&b, &tops[i], steps);
        seconds[repeat] = now() - begin;
    }
    qsort(seconds, 5, sizeof(double), ascending);
    printf("%.6e %.15e %.15e %.15e\n", seconds[2] / ((double)groups * LANES * steps), (double)tops[0].p.x[0],
           (double)tops[0].p.y[0], (double)tops[0].p.z[0]);
    free(tops);
}
