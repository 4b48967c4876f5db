/* The limit of a sum over facets: the torque of sunlight on many bodies, by hand for the vector units of the machine.

   Each body has its own direction of the Sun, and all have the same facets. For the numbers of a facet see
   midlie_jax/asteroids/brightness.py: n, what is taken times the centroid, the lever of n, and two weights.

       ./facets FILE FACETS BODIES ROUNDS    FILE holds the facets (11 numbers each) and the directions (three arrays).
                                             Prints the least seconds of a round in processor time, and the torque on the
                                             first body.

   REAL and INTEGER are the types of a number and of a mask, VECTORS how many vector registers hold one number of a group
   of bodies: surfaces.py takes the fastest. */

#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#if defined(__AVX512F__)
#define WIDTH 64
#elif defined(__AVX2__)
#define WIDTH 32
#else
#define WIDTH 16
#endif
#define COLUMNS 11

typedef REAL vec __attribute__((vector_size(WIDTH * VECTORS), aligned(sizeof(REAL))));
typedef INTEGER mask __attribute__((vector_size(WIDTH * VECTORS)));
#define LANES ((int)(sizeof(vec) / sizeof(REAL)))

static void torque(const REAL *table, int facets, vec x, vec y, vec z, vec *out) {
    vec pushed[3] = {}, turned[3] = {};
    for (int i = 0; i < facets; i++) {
        const REAL *f = table + COLUMNS * i;
        vec cosine = f[0] * x + f[1] * y + f[2] * z;
        cosine = (vec)((mask)cosine & (mask)(cosine > 0));
        vec across = cosine * (f[9] + f[10] * cosine);
        for (int k = 0; k < 3; k++) pushed[k] += cosine * f[3 + k], turned[k] += across * f[6 + k];
    }
    out[0] = pushed[1] * z - pushed[2] * y + turned[0];
    out[1] = pushed[2] * x - pushed[0] * z + turned[1];
    out[2] = pushed[0] * y - pushed[1] * x + turned[2];
}

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}

int main(int count, char **words) {
    if (count != 5) return fprintf(stderr, "usage: facets FILE FACETS BODIES ROUNDS\n"), 2;
    int facets = atoi(words[2]), bodies = atoi(words[3]) / LANES * LANES, rounds = atoi(words[4]);
    size_t numbers = (size_t)facets * COLUMNS, all = 3 * (size_t)atoi(words[3]);
    REAL *table = malloc(numbers * sizeof(REAL)), *u = malloc(all * sizeof(REAL)), *out = malloc(all * sizeof(REAL));
    FILE *file = fopen(words[1], "rb");
    if (!file || fread(table, sizeof(REAL), numbers, file) != numbers || fread(u, sizeof(REAL), all, file) != all)
        return fprintf(stderr, "%s is too short\n", words[1]), 2;
    double least = 1e9;
    for (int round = 0; round < rounds; round++) {
        double begin = now();
        for (int i = 0; i < bodies; i += LANES) {
            vec found[3], *at[3];
            for (int k = 0; k < 3; k++) at[k] = (vec *)(u + k * (all / 3) + i);
            torque(table, facets, *at[0], *at[1], *at[2], found);
            for (int k = 0; k < 3; k++) *(vec *)(out + k * (all / 3) + i) = found[k];
        }
        double seconds = now() - begin;
        least = seconds < least ? seconds : least;
    }
    printf("%.6e %.15e %.15e %.15e\n", least, (double)out[0], (double)out[all / 3], (double)out[2 * (all / 3)]);
}
