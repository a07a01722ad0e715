/* The common drive of drive.py as a C loop with fixed steps: no effects, no gear, no
   sensors. out: rows of torque (N m) and phase currents (A), means over steps_a_sample. */
#include <math.h>

struct drive {
    double r, l, k, v_leg, band, i_max, j, dry, viscous, omega, kp, ki, period;
};

static const double SIGNS[6][3] = {{1, -1, 0}, {1, 0, -1}, {0, 1, -1},
                                   {-1, 1, 0}, {-1, 0, 1}, {0, -1, 1}};

void simulate(const struct drive *d, double theta, double dt, long samples, long steps_a_sample,
              double *out)
{
    const double third = 2.0943951023931953;
    double i[3] = {0, 0, 0}, s[3] = {1, 1, 1}, omega = d->omega, integral = 0;

    for (long n = 0; n < samples; n++) {
        double sum[4] = {0, 0, 0, 0};
        double error = d->omega - omega, grown = integral + d->ki * error * d->period;
        double i_ref = d->kp * error + grown;
        if (fabs(i_ref) > d->i_max && i_ref * error > 0) {
            grown = integral;
            i_ref = d->kp * error + grown;
        }
        integral = grown;
        i_ref = fmin(fmax(i_ref, -d->i_max), d->i_max);
        for (long m = 0; m < steps_a_sample; m++) {
            int sector = ((int)floor((theta - third / 4) / (third / 2)) % 6 + 6) % 6;
            double k[3] = {d->k * sin(theta), d->k * sin(theta - third), d->k * sin(theta + third)};
            double x[3], v_n = 0, torque = 0;
            for (int j = 0; j < 3; j++) {
                double ref = SIGNS[sector][j] * i_ref;
                if (i[j] >= ref + d->band)
                    s[j] = -1;
                else if (i[j] <= ref - d->band)
                    s[j] = 1;
                x[j] = d->v_leg * s[j] - d->r * i[j] - k[j] * omega;
                v_n += x[j] / 3;
            }
            for (int j = 0; j < 3; j++) {
                i[j] += dt * (x[j] - v_n) / d->l;
                torque += k[j] * i[j];
                sum[1 + j] += i[j];
            }
            omega += dt * (torque - d->dry - d->viscous * omega) / d->j;
            theta += dt * omega;
            sum[0] += torque;
        }
        for (int j = 0; j < 4; j++)
            out[4 * n + j] = sum[j] / steps_a_sample;
    }
}
