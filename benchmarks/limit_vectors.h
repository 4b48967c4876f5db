/* Numbers of many tops at once, in the vector extensions of GCC and Clang, or of one top for each thread of a GPU; vectors
   and quaternions of such numbers. */

#include <math.h>

#if defined(__CUDACC__)
#define TABLE static __constant__ const
#else
#define TABLE static const
#endif
#include "limit.h" /* written by limit.py: REAL, INTEGER and the constants of midlie_jax in this precision */

#if defined(__CUDACC__)
typedef REAL vec;
typedef INTEGER mask;
#define LANES 1
#define LANE(x, i) (x)
#define INLINE static __device__ __host__ __forceinline__
#else
#if defined(__AVX512F__)
#define WIDTH 64 /* the bytes of one vector register */
#elif defined(__AVX2__)
#define WIDTH 32
#else
#define WIDTH 16
#endif

/* A `vec` holds VECTORS registers: what one register waits for, the others can use. */
typedef REAL vec __attribute__((vector_size(WIDTH * VECTORS)));
typedef INTEGER mask __attribute__((vector_size(WIDTH * VECTORS)));
#define LANES ((int)(sizeof(vec) / sizeof(REAL)))
#define LANE(x, i) ((x)[i])
#define INLINE static inline __attribute__((always_inline))
#endif

typedef struct { REAL x, y, z; } real3; /* the same for all tops */
typedef struct { vec x, y, z; } vec3;
typedef struct { vec w, x, y, z; } quat;

INLINE vec dot(vec3 a, vec3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
INLINE vec weigh(real3 a, vec3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
INLINE vec3 times(real3 a, vec3 b) { return (vec3){a.x * b.x, a.y * b.y, a.z * b.z}; }
INLINE vec3 scale(vec c, vec3 a) { return (vec3){c * a.x, c * a.y, c * a.z}; }
INLINE vec3 stretch(REAL c, vec3 a) { return (vec3){c * a.x, c * a.y, c * a.z}; }
INLINE vec3 product(vec3 a, vec3 b) { return (vec3){a.x * b.x, a.y * b.y, a.z * b.z}; }
INLINE vec3 add(vec3 a, vec3 b) { return (vec3){a.x + b.x, a.y + b.y, a.z + b.z}; }
INLINE vec3 subtract(vec3 a, vec3 b) { return (vec3){a.x - b.x, a.y - b.y, a.z - b.z}; }
INLINE vec3 axpy(vec c, vec3 a, vec3 b) { return (vec3){c * a.x + b.x, c * a.y + b.y, c * a.z + b.z}; }
INLINE vec3 cross(vec3 a, vec3 b) {
    return (vec3){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

INLINE quat multiply(quat a, quat b) {
    return (quat){a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z, a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
                  a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x, a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w};
}
INLINE vec3 rotate_back(quat q, vec3 v) {
    vec3 u = {-q.x, -q.y, -q.z}, t = stretch(2, cross(u, v));
    return axpy(q.w, t, add(v, cross(u, t)));
}
INLINE quat unit(quat q) { /* Newton's step towards length one */
    vec f = (REAL)1.5 - (REAL).5 * (q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z);
    return (quat){f * q.w, f * q.x, f * q.y, f * q.z};
}

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
#define COUNT(table) ((int)(sizeof(table) / sizeof(*table)))
#define POLYNOMIAL(table, x) polynomial(table, COUNT(table), x)

INLINE int any_lane(mask m) {
    INTEGER total = 0;
    for (int i = 0; i < LANES; i++) total |= LANE(m, i);
    return total != 0;
}

/* Roots, and reciprocals of positive numbers: by the machine's instructions, or by Newton steps from a guess read from the
   bits, as in midlie_jax/_math/components.py. The machine's keep its one divider busy for long; Newton's steps need more
   multiplications. limit.py tries both. A `rough` reciprocal needs five digits only. */
#if HARDWARE_ROOTS
INLINE vec root(vec x) {
    vec r;
    for (int i = 0; i < LANES; i++) LANE(r, i) = sizeof(REAL) == 8 ? (REAL)sqrt(LANE(x, i)) : (REAL)sqrtf(LANE(x, i));
    return r;
}
INLINE vec inverse_root(vec x) { return 1 / root(x); }
INLINE vec reciprocal(vec x) { return 1 / x; }
INLINE vec rough_reciprocal(vec x) { return 1 / x; }
#else
INLINE vec inverse_root(vec x) {
    vec guess = (vec)(ROOT_MAGIC - ((mask)x >> 1)), half = (REAL).5 * x;
    for (int i = 0; i < ROOT_STEPS; i++) guess = guess + guess * ((REAL).5 - half * guess * guess);
    return guess;
}
INLINE vec root(vec x) { return x * inverse_root(x); }
INLINE vec rough_reciprocal(vec x) {
    vec guess = (vec)(RECIPROCAL_MAGIC - (mask)x), error = 1 - x * guess;
    guess = guess + guess * error;
    return guess + guess * (error * error);
}
INLINE vec reciprocal(vec x) {
    vec guess = rough_reciprocal(x);
    for (int i = 0; i < RECIPROCAL_STEPS; i++) guess = guess + guess * (1 - x * guess);
    return guess;
}
#endif
