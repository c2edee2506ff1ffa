/* Fixed-step integration of dx/dt = f(t, x), inputs and parameters held. */
#ifndef INTEGRATE_H
#define INTEGRATE_H

#include "block.h"

/* Doubles of scratch memory that a step needs for n states. */
#define INTEGRATE_SCRATCH(n) (3 * (n))

/* One step of the classical Runge-Kutta method. `lost` (n) carries the rounding errors of earlier steps (Kahan summation):
   without it the momentum of a free robot walks away by some 1e-13 in 1e6 steps. */
void integrate_runge_kutta(Equations *rates, double t, double h, const double *p, const double *u, double *x, double *lost,
                           int n, double *scratch);

#endif
