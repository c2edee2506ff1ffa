/* Fixed-step integration of dx/dt = f(t, x) with constant inputs and parameters. */
#ifndef INTEGRATE_H
#define INTEGRATE_H

#include "block.h"

/* Number of doubles that `scratch` needs for a step with n states. */
#define INTEGRATE_SCRATCH(n) (3 * (n))

/* Makes one step of size h from time t, with the classical Runge-Kutta method. The states x (n) are
   changed in place. `lost` (n) contains the rounding errors of earlier steps (Kahan summation).
   tests/benchmarks/drift.py prints the drift of energy and momenta of a free robot. */
void integrate_runge_kutta(Equations *rates, double t, double h, const double *p, const double *u,
                           double *x, double *lost, int n, double *scratch);

#endif
