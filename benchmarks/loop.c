/* The published pipeline over bodies on Kepler orbits, as plain C: the limit that the harness is
 * measured against. The same arithmetic as umbra_bench/umbra/pipeline.py and CentralGravity, and the
 * same energy, of which the largest value is kept. REAL is float or double. */
#include <math.h>
#include <tgmath.h>

REAL orbit(int bodies, long steps, REAL dt, REAL mu,
           REAL *x, REAL *y, REAL *angle, REAL *vx, REAL *vy, REAL *omega,
           REAL *ax, REAL *ay, REAL *alpha)
{
    const REAL two_pi = (REAL)6.283185307179586, half = (REAL)0.5, one = 1;
    REAL highest = -INFINITY;
    for (long n = 0; n < steps; n++) {
        REAL energy = 0;
        for (int i = 0; i < bodies; i++) {
            REAL inverse = one / sqrt(x[i] * x[i] + y[i] * y[i]);
            energy += half * (vx[i] * vx[i] + vy[i] * vy[i] + omega[i] * omega[i]) - mu * inverse;

            REAL pull = -(mu * inverse) * (inverse * inverse);
            REAL fx = pull * x[i], fy = pull * y[i], torque = 0;

            vx[i] += (ax[i] + fx) * half * dt;
            vy[i] += (ay[i] + fy) * half * dt;
            omega[i] += (alpha[i] + torque) * half * dt;
            ax[i] = fx;
            ay[i] = fy;
            alpha[i] = torque;

            x[i] += vx[i] * dt + fx * (dt * dt * half);
            y[i] += vy[i] * dt + fy * (dt * dt * half);
            REAL turned = angle[i] + (omega[i] * dt + torque * (dt * dt * half));
            turned -= two_pi * floor(turned / two_pi);
            angle[i] = (turned >= two_pi || turned < 0) ? 0 : turned;
        }
        highest = energy > highest ? energy : highest;
    }
    return highest;
}
