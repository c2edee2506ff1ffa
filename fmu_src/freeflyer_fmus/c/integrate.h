/* Fixed-step integration of dx/dt = f(t, x) with constant inputs and parameters. */
#ifndef INTEGRATE_H
#define INTEGRATE_H

#include "block.h"

/* Number of doubles that `scratch` needs for a step with n states. */
#define INTEGRATE_SCRATCH(n) (3 * (n))

/* Makes one step of size h from time t, with the classical Runge-Kutta method. The states x (n) are
   changed in place. `lost` (n) contains the rounding errors of earlier steps (Kahan summation).
   With Kahan summation, energy and momentum of a free robot drift by less than 1e-15 in 1e5 steps
   of 1 ms. Without Kahan summation, they drift by 4e-14 to 9e-14. */
void integrate_runge_kutta(Equations *rates, double t, double h, const double *p, const double *u,
                           double *x, double *lost, int n, double *scratch);

#endif
