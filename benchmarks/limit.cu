/* The limit on a GPU: the arithmetic of limit.c with one thread for each top and one kernel for the whole run, so that a
   top stays in registers from the first step to the last. gpu.py builds and times it; METHOD as in limit.c.

       ./limit BODIES STEPS DT I1 I2 I3 WEIGHT    prints the median seconds a body-step of seven runs, and the momentum of
                                                  the first top at the end */

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#define HARDWARE_ROOTS 1
#include "limit_vectors.h"
#include "limit_top.h"
#include "limit_dop853.h"
#include "limit_jacobi.h"
#include "limit_liemid.h"
#include "limit_symmetric.h"

#define JOINED(a, b) a##b
#define STEP_OF(method) JOINED(step_, method)
#define THREADS 128
#define REPEATS 7

/* The numbers of a top one after the other for all tops, so that the threads of a warp read neighbours. */
static __global__ void run(body b, REAL *numbers, int bodies, int steps) {
    int i = blockIdx.x * THREADS + threadIdx.x;
    if (i >= bodies) return;
    REAL *x = numbers + i;
    long n = bodies;
    top s = {{x[0], x[n], x[2 * n]}, {x[3 * n], x[4 * n], x[5 * n], x[6 * n]}, 0, 0};
    pull(&b, &s);
    for (int step = 0; step < steps; step++) STEP_OF(METHOD)(&b, &s);
    x[0] = s.p.x, x[n] = s.p.y, x[2 * n] = s.p.z;
    x[3 * n] = s.q.w, x[4 * n] = s.q.x, x[5 * n] = s.q.y, x[6 * n] = s.q.z;
}

static int ascending(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

int main(int count, char **words) {
    if (count != 8) return fprintf(stderr, "usage: limit BODIES STEPS DT I1 I2 I3 WEIGHT\n"), 2;
    long bodies = atol(words[1]), size = 7 * bodies * sizeof(REAL);
    int steps = atoi(words[2]);
    double moments[3] = {atof(words[4]), atof(words[5]), atof(words[6])}, seconds[REPEATS];
    body b = body_of(moments, atof(words[7]), atof(words[3]));
    REAL *start = (REAL *)calloc(7 * bodies, sizeof(REAL)), *numbers;
    for (long i = 0; i < bodies; i++) /* the fast top P1, its spin varied a little from top to top */
        start[2 * bodies + i] = (REAL)(50 + 1e-3 * i / bodies), start[3 * bodies + i] = (REAL)cos(.025),
                           start[4 * bodies + i] = (REAL)sin(.025);
    cudaEvent_t begin, end;
    cudaMalloc(&numbers, size), cudaEventCreate(&begin), cudaEventCreate(&end);
    for (int repeat = 0; repeat < REPEATS; repeat++) {
        float milliseconds;
        cudaMemcpy(numbers, start, size, cudaMemcpyHostToDevice);
        cudaEventRecord(begin);
        run<<<(bodies + THREADS - 1) / THREADS, THREADS>>>(b, numbers, bodies, steps);
        cudaEventRecord(end), cudaEventSynchronize(end), cudaEventElapsedTime(&milliseconds, begin, end);
        seconds[repeat] = 1e-3 * milliseconds;
    }
    cudaMemcpy(start, numbers, size, cudaMemcpyDeviceToHost);
    if (cudaGetLastError() != cudaSuccess) return fprintf(stderr, "the kernel failed\n"), 1;
    qsort(seconds, REPEATS, sizeof(double), ascending);
    printf("%.6e %.15e %.15e %.15e\n", seconds[REPEATS / 2] / ((double)bodies * steps), (double)start[0],
           (double)start[bodies], (double)start[2 * bodies]);
}
