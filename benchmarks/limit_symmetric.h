/* SYMMETRIC: exp(h Pi/I1) exp(angle e3), angle = h (1/I3 - 1/I1) Pi3, with I1 = I2 and the axis of symmetry known to be the
   third. See midlie_jax/integrators/flights/symmetric.py. */

INLINE void fly_symmetric(const body *b, REAL h, top *s) {
    vec3 w = stretch(h / 2 * b->inverses.x, s->p);
    vec half = h / 2 * (b->inverses.z - b->inverses.x) * s->p.z, x = dot(w, w), sine = POLYNOMIAL(SINE, x);
    quat turn = {POLYNOMIAL(COSINE, x), sine * w.x, sine * w.y, sine * w.z};
    vec c = POLYNOMIAL(SPIN_COSINE, half * half), d = half * POLYNOMIAL(SPIN_SINE, half * half);
    turn = multiply(turn, turn);
    s->q = multiply(s->q, (quat){turn.w * c - turn.z * d, turn.x * c + turn.y * d, turn.y * c - turn.x * d,
                                 turn.w * d + turn.z * c});
    vec cosine = c * c - d * d, sine_of_angle = 2 * c * d;
    s->p = (vec3){cosine * s->p.x + sine_of_angle * s->p.y, cosine * s->p.y - sine_of_angle * s->p.x, s->p.z};
}
INLINE void step_SYMMETRIC(const body *b, top *s) { verlet(b, s, 1, fly_symmetric); }
