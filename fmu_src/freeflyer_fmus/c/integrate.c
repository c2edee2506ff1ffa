#include "integrate.h"

void integrate_runge_kutta(Equations *rates, double t, double h, const double *p, const double *u,
                           double *x, double *lost, int n, double *scratch)
{
    double *stage = scratch, *slope = scratch + n, *sum = scratch + 2 * n;
    double middle = t + 0.5 * h, end = t + h;

    rates(&t, p, u, x, sum, 0, 0);
    for (int i = 0; i < n; i++)
        stage[i] = x[i] + 0.5 * h * sum[i];
    rates(&middle, p, u, stage, slope, 0, 0);
    for (int i = 0; i < n; i++) {
        sum[i] += 2.0 * slope[i];
        stage[i] = x[i] + 0.5 * h * slope[i];
    }
    rates(&middle, p, u, stage, slope, 0, 0);
    for (int i = 0; i < n; i++) {
        sum[i] += 2.0 * slope[i];
        stage[i] = x[i] + h * slope[i];
    }
    rates(&end, p, u, stage, slope, 0, 0);
    for (int i = 0; i < n; i++) {
        double change = h / 6.0 * (sum[i] + slope[i]) - lost[i];
        double next = x[i] + change;
        lost[i] = (next - x[i]) - change;
        x[i] = next;
    }
}
