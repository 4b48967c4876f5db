/* The body, which all tops share; a group of tops, one in each lane; and the step that all flights have in common. */

/* As in midlie_jax/model/inertia.py. The numbers come from the command line, so that the compiler cannot use that two
   moments are equal: the package's programs serve any moments, too. */
typedef struct {
    real3 inverses, relative, spins, gaps, middle;
    REAL per_unit, weight, h;
} body;

INLINE body body_of(const double *i, double weight, double h) {
    double largest = fmax(fmax(i[0], i[1]), i[2]), s[3] = {largest / i[0], largest / i[1], largest / i[2]};
    double d[3] = {(i[1] - i[2]) / largest, (i[2] - i[0]) / largest, (i[0] - i[1]) / largest};
    int first = d[1] * d[2] >= 0, second = !first && d[2] * d[0] >= 0;
    return (body){
        .inverses = {1 / i[0], 1 / i[1], 1 / i[2]},
        .relative = {1 / s[0], 1 / s[1], 1 / s[2]},
        .spins = {s[0], s[1], s[2]},
        .gaps = {d[0] * s[1] * s[2], d[1] * s[2] * s[0], d[2] * s[0] * s[1]},
        .middle = {first, second, !first && !second},
        .per_unit = 1 / largest,
        .weight = weight,
        .h = h,
    };
}

typedef struct { vec3 p; quat q; vec pull_x, pull_y; } top; /* the torque at this attitude is (pull_x, pull_y, 0) */

INLINE void pull(const body *b, top *s) { /* the torque of V = weight (R e3).z */
    REAL twice = 2 * b->weight;
    s->pull_x = twice * (s->q.y * s->q.z + s->q.w * s->q.x);
    s->pull_y = -twice * (s->q.x * s->q.z - s->q.w * s->q.y);
}
INLINE void kick(REAL h, top *s) { s->p.x += h * s->pull_x, s->p.y += h * s->pull_y; }
INLINE void turn(top *s, quat increment) { s->p = rotate_back(increment, s->p), s->q = multiply(s->q, increment); }

/* Half a kick, the flights, half a kick. The torque at the end serves the next step as well. */
INLINE void verlet(const body *b, top *s, int flights, void (*fly)(const body *, REAL, top *)) {
    kick(b->h / 2, s);
    for (int i = 0; i < flights; i++) fly(b, b->h / flights, s);
    s->q = unit(s->q);
    pull(b, s);
    kick(b->h / 2, s);
}
