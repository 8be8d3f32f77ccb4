/* The plant again, in plain C: same recurrence, other program.
 *
 * It takes physical values by name, discretises with its own power series and keeps one struct per
 * wheel; it shares no table, constant or line with the compiled kernels. It serves the conformance
 * vectors and, with every term at null, the speed comparison of `hilserver bench plant`.
 *
 * Order of a tick: set-point (delay, rate), encoder, controller, dead zone, friction, process, side
 * speeds, radii, turn rate, slip, pose.
 */
#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#define RING 1024
#define PI 3.14159265358979323846

struct wheel {
    double x, n, integral, derivative, last_error, duty, filtered, last_n, angle, gap, s, m;
};

struct plant {
    /* physical values */
    double T, r, ly, icr, k_om, yaw_sign, max_rpm;
    double kp, ki, kd, N, limit_pct, G, T1, T2;
    /* terms, in the order of the contract */
    double actuation_delay, rate_limit, encoder_a, encoder_wheel, encoder_filter, quantum;
    double control_period, a_p, a_i, limit;
    double dead_zone, coulomb, f_s, n_s, load, load_wheel, a_gain, a_t1, sag_k, volts, viscous;
    double backlash, a_radius, a_diff, runout, runout_phase, a_k, a_kv, a_kq, long_slip, acc_slip;
    double traction, lag, mecanum, roller, icr_d, side_slip, misalign, slope_x, slope_y, surf_k, surf_v, x_min, x_max, y_min, y_max;
    double aniso_k, aniso_icr;
    /* sensors: their slice, and terms */
    double Ts, nav_every, seed, gyro_a, gyro_bias, imu_latency, nav_latency, yaw_latency;
    double lever_x, lever_y, nav_scale, frame_yaw, bias, bias_length, outlier_share, outlier_size;
    double dist_a1, dist_p1, dist_a2, dist_p2;
    /* worked out by plant_prepare */
    double A[2][2], B[2], Tt, Tc, tau_d, inverse_Tt, inverse_T2;
    int extended;
    /* state */
    struct wheel w[4];
    double X, Y, yaw, lagged_v, lagged_om, next_control, pose_request;
    long tick;
    double ring[RING][4];
    /* outputs of t_k */
    double v, vy, om, acc_x, acc_y;
    /* what the sensors remember: gyro, yaw, two accelerations, x, y at every run */
    double past[RING][6];
    long runs, samples;
    double nav[3];
};

/* exp of a 3x3 matrix by scaling, Taylor series and squaring */
static void expm3(double M[3][3], double E[3][3])
{
    double term[3][3], next[3][3];
    const double scale = 1.0 / 1024.0;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            M[i][j] *= scale;
            E[i][j] = 0.0; /* E is exp(M) - 1, so that small entries keep their digits */
            term[i][j] = (i == j);
        }
    for (int k = 1; k < 25; k++) {
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) {
                double sum = 0.0;
                for (int l = 0; l < 3; l++)
                    sum += term[i][l] * M[l][j];
                next[i][j] = sum / k;
            }
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) {
                term[i][j] = next[i][j];
                E[i][j] += term[i][j];
            }
    }
    for (int k = 0; k < 10; k++) { /* (1 + E)^2 - 1 = 2 E + E^2 */
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) {
                double sum = 0.0;
                for (int l = 0; l < 3; l++)
                    sum += E[i][l] * E[l][j];
                next[i][j] = 2.0 * E[i][j] + sum;
            }
        memcpy(E, next, sizeof next);
    }
    for (int i = 0; i < 3; i++)
        E[i][i] += 1.0;
}

static void process(const struct plant *p, double A[2][2], double B[2])
{
    double T1 = p->T1 * (1.0 + p->a_t1), T2 = p->T2;
    double G = p->G * (1.0 + p->a_gain) * (1.0 + p->sag_k * (p->volts / 19.2 - 1.0));
    double M[3][3] = {
        {-p->T / T1, -p->T * G * p->viscous / T1, p->T * G / T1},
        {p->T / T2, -p->T / T2, 0.0},
        {0.0, 0.0, 0.0},
    };
    double E[3][3];
    expm3(M, E);
    for (int i = 0; i < 2; i++) {
        A[i][0] = E[i][0];
        A[i][1] = E[i][1];
        B[i] = E[i][2];
    }
}

struct field {
    const char *name;
    size_t offset;
};
#define F(name) {#name, offsetof(struct plant, name)}
#define TERM(term, name) {term, offsetof(struct plant, name)}
static const struct field fields[] = {
    F(T), F(r), F(max_rpm), F(ly), F(icr), F(k_om), F(yaw_sign), F(kp), F(ki), F(kd), F(N),
    F(limit_pct), F(G), F(T1), F(T2), F(volts), F(mecanum), F(aniso_k), F(aniso_icr), F(Ts),
    F(nav_every), F(seed),
    TERM("actuation_delay", actuation_delay),
    TERM("setpoint_rate_limit", rate_limit),
    TERM("encoder_scale.a", encoder_a),
    TERM("encoder_scale.wheel", encoder_wheel),
    TERM("encoder_filter", encoder_filter),
    TERM("encoder_quantization", quantum),
    TERM("control_period", control_period),
    TERM("controller_gains.p", a_p),
    TERM("controller_gains.i", a_i),
    TERM("saturation_limit", limit),
    TERM("dead_zone", dead_zone),
    TERM("coulomb_friction", coulomb),
    TERM("stribeck_friction.f_s", f_s),
    TERM("stribeck_friction.n_s", n_s),
    TERM("wheel_load.f", load),
    TERM("wheel_load.wheel", load_wheel),
    TERM("process_gain", a_gain),
    TERM("time_constant", a_t1),
    TERM("battery_sag", sag_k),
    TERM("viscous_load", viscous),
    TERM("backlash", backlash),
    TERM("wheel_radius", a_radius),
    TERM("wheel_radius_difference", a_diff),
    TERM("wheel_runout.amplitude", runout),
    TERM("wheel_runout.phase", runout_phase),
    TERM("rotation_gain", a_k),
    TERM("rotation_gain_speed", a_kv),
    TERM("rotation_gain_radius", a_kq),
    TERM("longitudinal_slip", long_slip),
    TERM("acceleration_slip", acc_slip),
    TERM("traction_slip", traction),
    TERM("body_lag", lag),
    TERM("roller_slip", roller),
    TERM("icr_offset", icr_d),
    TERM("side_slip", side_slip),
    TERM("wheel_misalignment", misalign),
    TERM("floor_slope.x", slope_x),
    TERM("floor_slope.y", slope_y),
    TERM("surface_change.k_om", surf_k),
    TERM("surface_change.v", surf_v),
    TERM("surface_change.x_min", x_min),
    TERM("surface_change.x_max", x_max),
    TERM("surface_change.y_min", y_min),
    TERM("surface_change.y_max", y_max),
    TERM("gyro_scale", gyro_a),
    TERM("gyro_bias", gyro_bias),
    TERM("imu_latency", imu_latency),
    TERM("nav_latency", nav_latency),
    TERM("yaw_latency", yaw_latency),
    TERM("nav_lever_arm.x", lever_x),
    TERM("nav_lever_arm.y", lever_y),
    TERM("nav_scale", nav_scale),
    TERM("nav_frame_yaw", frame_yaw),
    TERM("nav_position_bias.amplitude", bias),
    TERM("nav_position_bias.wavelength", bias_length),
    TERM("nav_outliers.share", outlier_share),
    TERM("nav_outliers.size", outlier_size),
    TERM("heading_distortion.a1", dist_a1),
    TERM("heading_distortion.phase1", dist_p1),
    TERM("heading_distortion.a2", dist_a2),
    TERM("heading_distortion.phase2", dist_p2),
};

struct plant *plant_new(void)
{
    struct plant *p = calloc(1, sizeof *p);
    if (p == NULL)
        return NULL;
    p->limit = 100.0;
    p->n_s = 6.0;
    p->volts = 19.2;
    p->x_max = p->y_max = 1000.0;
    p->y_min = -1000.0;
    p->aniso_k = 1.0;
    p->rate_limit = INFINITY;
    p->bias_length = 5.0;
    p->outlier_size = 1.5;
    p->nav_every = 1.0;
    return p;
}

void plant_free(struct plant *p)
{
    free(p);
}

int plant_set(struct plant *p, const char *name, double value)
{
    for (size_t k = 0; k < sizeof fields / sizeof *fields; k++)
        if (strcmp(fields[k].name, name) == 0) {
            *(double *)((char *)p + fields[k].offset) = value;
            return 0;
        }
    return -1;
}

void plant_prepare(struct plant *p, int extended)
{
    process(p, p->A, p->B);
    p->Tt = p->kd == 0.0 ? sqrt(1.0 / p->ki) : sqrt(p->kd / p->ki);
    p->tau_d = p->kd == 0.0 ? 1.0 / (p->N * p->kp) : p->kd / (p->N * p->kp);
    p->Tc = p->control_period > 0.0 ? p->control_period : p->T;
    p->inverse_Tt = 1.0 / p->Tt;
    p->inverse_T2 = 1.0 / p->T2;
    p->extended = extended;
}

static double clip(double value, double limit)
{
    return value > limit ? limit : value < -limit ? -limit : value;
}

static double sign(double value)
{
    return value > 0.0 ? 1.0 : value < 0.0 ? -1.0 : 0.0;
}

static double rpm_to_rad_s(double rpm)
{
    return rpm * (2.0 * PI / 60.0);
}

static double wrapped(double angle)
{
    while (angle > PI)
        angle -= 2.0 * PI;
    while (angle <= -PI)
        angle += 2.0 * PI;
    return angle;
}

static void integrate_pose(struct plant *p, double v, double vy, double om)
{
    double half = 0.5 * om * p->T;
    double chord = p->T;
    if (fabs(half) < 0.05) {
        double h2 = half * half;
        chord *= 1.0 - h2 / 6.0 * (1.0 - h2 / 20.0 * (1.0 - h2 / 42.0));
    } else {
        chord *= sin(half) / half;
    }
    double heading = p->yaw + half;
    double c = cos(heading), s = sin(heading);
    p->X += chord * (v * c - vy * s);
    p->Y += chord * (v * s + vy * c);
    heading += half;
    if (heading > PI || heading <= -PI)
        heading = wrapped(heading);
    p->yaw = heading;
}

/* the base model: every term at null */
static void base_step(struct plant *p, const double *setpoint)
{
    double w[4], mean[4], rate[4];
    double limit = p->limit_pct;
    for (int i = 0; i < 4; i++) {
        struct wheel *k = &p->w[i];
        double n = k->n, x = k->x;
        double e = setpoint[i] - n;
        double wanted = p->kp * e + k->integral;
        double u = clip(wanted, limit);
        k->m = n;
        k->duty = u;
        k->integral += p->T * (p->ki * e + (u - wanted) * p->inverse_Tt);
        k->x = p->A[0][0] * x + p->A[0][1] * n + p->B[0] * u;
        k->n = p->A[1][0] * x + p->A[1][1] * n + p->B[1] * u;
        w[i] = n;
        mean[i] = 0.5 * (n + k->n);
        rate[i] = (x - n) * p->inverse_T2;
        k->angle += p->T * rpm_to_rad_s(mean[i]);
    }
    double wl = rpm_to_rad_s(0.5 * (w[0] + w[1])), wr = rpm_to_rad_s(0.5 * (w[2] + w[3]));
    double dl = rpm_to_rad_s(0.5 * (rate[0] + rate[1])), dr = rpm_to_rad_s(0.5 * (rate[2] + rate[3]));
    double ml = rpm_to_rad_s(0.5 * (mean[0] + mean[1])), mr = rpm_to_rad_s(0.5 * (mean[2] + mean[3]));
    double turn = p->yaw_sign * p->r * p->k_om;
    p->v = p->r * (wl - wr) / 2.0;
    p->om = turn * (wl + wr);
    p->vy = -p->icr * p->om;
    double dv = p->r * (dl - dr) / 2.0, dom = turn * (dl + dr);
    p->acc_x = dv - p->om * p->vy;
    p->acc_y = -p->icr * dom + p->om * p->v;
    double om = turn * (ml + mr);
    integrate_pose(p, p->r * (ml - mr) / 2.0, -p->icr * om, om);
}

/* one run of steps 8 to 10 */
static void velocity(const struct plant *p, double wl, double wr, double dwl, double dwr,
                     double angle, double *v, double *om)
{
    double rl = p->r * (1.0 + p->a_radius) * (1.0 + p->a_diff / 2.0);
    double rr = p->r * (1.0 + p->a_radius) * (1.0 - p->a_diff / 2.0);
    double theta = angle + p->runout_phase;
    double drl = rl * p->runout * cos(theta) * wl;
    rl *= 1.0 + p->runout * sin(theta);
    double v0 = (rl * wl - rr * wr) / 2.0;
    double dv0 = (drl * wl + rl * dwl - rr * dwr) / 2.0;
    double om0 = fabs(p->r * p->k_om * (wl + wr));
    double q = fabs(v0) + p->ly * om0 / 2.0;
    q = q > 0.0 ? fabs(v0) / q : 0.0;
    int inside = p->X >= p->x_min && p->X <= p->x_max && p->Y >= p->y_min && p->Y <= p->y_max;
    double K = p->k_om * (1.0 + p->a_k) * p->aniso_k;
    K *= (1.0 + p->a_kv * fabs(v0)) * (1.0 + p->a_kq * q) * (inside ? 1.0 + p->surf_k : 1.0);
    *om = p->yaw_sign * K * (rl * wl + rr * wr);
    *v = v0 * (1.0 - p->long_slip * fabs(*om)) * fmax(0.0, 1.0 - p->acc_slip * fabs(dv0));
    *v *= (1.0 - p->traction) * (inside ? 1.0 + p->surf_v : 1.0);
}

/* the rest of step 10, for the velocity that the body has */
static double lateral(const struct plant *p, double v, double om)
{
    return -(p->icr + p->icr_d + p->aniso_icr) * om + p->side_slip * v * om + p->misalign * v;
}

/* to the left by the rollers, of four wheels in rpm: those of each side turn apart */
static double aside(const struct plant *p, const double *n)
{
    double r = p->r * (1.0 + p->a_radius), half = p->a_diff / 2.0;
    double left = r * (1.0 + half) * rpm_to_rad_s(n[1] - n[0]);
    double right = r * (1.0 - half) * rpm_to_rad_s(n[3] - n[2]);
    return p->mecanum != 0.0 ? (1.0 - p->roller) * (left + right) / 4.0 : 0.0;
}

static double friction(const struct plant *p, int i, double n)
{
    double F = p->coulomb + p->f_s * exp(-(n / p->n_s) * (n / p->n_s));
    return i == (int)p->load_wheel ? F + p->load : F;
}

static void extended_step(struct plant *p, const double *setpoint)
{
    double now[4], motor[4], mean[4], rate[4];
    int control = (double)p->tick * p->T >= p->next_control - 1e-9 * p->T;
    if (control)
        p->next_control += p->Tc;
    long lag = (long)ceil(p->actuation_delay / p->T - 1e-9);
    for (int i = 0; i < 4; i++) {
        struct wheel *k = &p->w[i];
        p->ring[p->tick % RING][i] = setpoint[i];
        double wanted_s = p->tick >= lag ? p->ring[(p->tick - lag) % RING][i] : 0.0;
        k->s += clip(wanted_s - k->s, p->rate_limit * p->T);
        if (p->rate_limit == INFINITY)
            k->s = wanted_s;
        double n = k->n, x = k->x;
        if (p->encoder_filter > 0.0) { /* PT1 under a ramp from last_n to n */
            double behind = (n - k->last_n) / p->T * p->encoder_filter;
            k->filtered = n - behind + (k->filtered - k->last_n + behind) * exp(-p->T / p->encoder_filter);
        } else
            k->filtered = n;
        k->last_n = n;
        k->m = k->filtered * (i == (int)p->encoder_wheel ? 1.0 + p->encoder_a : 1.0);
        if (p->quantum > 0.0)
            k->m = p->quantum * floor(k->m / p->quantum + 0.5);
        if (control) {
            double e = k->s - k->m;
            if (p->kd > 0.0)
                k->derivative += p->Tc / (p->tau_d + p->Tc)
                                 * (p->kd * (e - k->last_error) / p->Tc - k->derivative);
            k->last_error = e;
            double w = p->kp * (1.0 + p->a_p) * e + k->integral + k->derivative;
            k->duty = clip(w, p->limit_pct * p->limit / 100.0);
            k->integral += p->Tc * (p->ki * (1.0 + p->a_i) * e + (k->duty - w) / p->Tt);
        }
        double u1 = sign(k->duty) * fmax(fabs(k->duty) - p->dead_zone, 0.0), u2;
        double F = friction(p, i, n);
        if (fabs(n) < 0.05)
            u2 = fabs(u1) <= F ? 0.0 : u1 - F * sign(u1);
        else
            u2 = u1 - F * sign(n);
        k->x = p->A[0][0] * x + p->A[0][1] * n + p->B[0] * u2;
        k->n = p->A[1][0] * x + p->A[1][1] * n + p->B[1] * u2;
        now[i] = n;
        mean[i] = 0.5 * (n + k->n);
        motor[i] = mean[i];
        rate[i] = (x - n) / p->T2;
        if (p->backlash > 0.0) {
            double turned = p->T * rpm_to_rad_s(mean[i]);
            double old = k->gap, half = p->backlash / 2.0;
            int front = old >= half && n > 0.0, back = old <= -half && n < 0.0;
            double reach = old + turned; /* what lies beyond the play moves the wheel */
            k->gap = clip(reach, half);
            mean[i] = (reach - k->gap) / (p->T * 2.0 * PI / 60.0);
            if (!front && !back)
                now[i] = rate[i] = 0.0;
        }
    }
    double wl = rpm_to_rad_s(0.5 * (now[0] + now[1])), wr = rpm_to_rad_s(0.5 * (now[2] + now[3]));
    double dl = rpm_to_rad_s(0.5 * (rate[0] + rate[1])), dr = rpm_to_rad_s(0.5 * (rate[2] + rate[3]));
    double ml = rpm_to_rad_s(0.5 * (mean[0] + mean[1])), mr = rpm_to_rad_s(0.5 * (mean[2] + mean[3]));
    double angle = 0.5 * (p->w[0].angle + p->w[1].angle);
    double made_v, made_om; /* by the wheels */
    velocity(p, wl, wr, dl, dr, angle, &made_v, &made_om);
    p->v = p->lag > 0.0 ? p->lagged_v : made_v;
    p->om = p->lag > 0.0 ? p->lagged_om : made_om;
    p->vy = lateral(p, p->v, p->om) + aside(p, now);
    /* the derivative of the velocity: central differences along the motion of the wheels at two
     * widths, extrapolated */
    double slope_v[2], slope_om[2];
    struct plant frozen = *p;
    frozen.acc_slip = 0.0; /* the rate of its factor would need the wheels' jerk */
    for (int k = 0; k < 2; k++) {
        double h = k == 0 ? 2e-6 : 1e-6, v[2], om[2];
        for (int side = 0; side < 2; side++) {
            double d = side == 0 ? -h : h;
            velocity(&frozen, wl + d * dl, wr + d * dr, dl, dr, angle + d * wl, &v[side], &om[side]);
        }
        slope_v[k] = (v[1] - v[0]) / (2.0 * h);
        slope_om[k] = (om[1] - om[0]) / (2.0 * h);
    }
    double v0, om0;
    velocity(&frozen, wl, wr, dl, dr, angle, &v0, &om0);
    double grip = v0 != 0.0 ? made_v / v0 : 1.0;
    double dv = grip * (4.0 * slope_v[1] - slope_v[0]) / 3.0;
    double dom = (4.0 * slope_om[1] - slope_om[0]) / 3.0;
    if (p->lag > 0.0) { /* lag * dv/dt = made - v */
        dv = (made_v - p->v) / p->lag;
        dom = (made_om - p->om) / p->lag;
    }
    double icr = p->icr + p->icr_d + p->aniso_icr;
    double dvy = -icr * dom + p->side_slip * (dv * p->om + p->v * dom) + p->misalign * dv
                 + aside(p, rate);
    p->acc_x = dv - p->om * p->vy;
    p->acc_y = dvy + p->om * p->v;
    /* the pose takes the means over the tick, at the mean wheel angle */
    for (int i = 0; i < 4; i++)
        p->w[i].angle += p->T * rpm_to_rad_s(motor[i]);
    angle = 0.5 * (angle + 0.5 * (p->w[0].angle + p->w[1].angle));
    double v_mean, om_mean;
    velocity(p, ml, mr, (ml - wl) * 2.0 / p->T, (mr - wr) * 2.0 / p->T, angle, &v_mean, &om_mean);
    if (p->lag > 0.0) { /* the mean of a first-order answer follows from where it ends */
        double rest = exp(-p->T / p->lag);
        double next_v = rest * p->lagged_v + (1.0 - rest) * v_mean;
        double next_om = rest * p->lagged_om + (1.0 - rest) * om_mean;
        v_mean -= (next_v - p->lagged_v) * p->lag / p->T;
        om_mean -= (next_om - p->lagged_om) * p->lag / p->T;
        p->lagged_v = next_v;
        p->lagged_om = next_om;
    }
    integrate_pose(p, v_mean, lateral(p, v_mean, om_mean) + aside(p, mean), om_mean);
    if (fabs(ml) + fabs(mr) > 0.05) {
        p->X += p->slope_x * p->T;
        p->Y += p->slope_y * p->T;
    }
    p->tick++;
}

/* One tick: set-points of four wheels in; out, all of t_k: speed, duty, angle of four wheels, pose,
 * velocity, acceleration of the centre of mass (20 numbers). */
void plant_tick(struct plant *p, const double *setpoint, double *out)
{
    for (int i = 0; i < 4; i++)
        out[8 + i] = p->w[i].angle;
    out[12] = p->X;
    out[13] = p->Y;
    out[14] = p->yaw;
    if (p->extended)
        extended_step(p, setpoint);
    else
        base_step(p, setpoint);
    for (int i = 0; i < 4; i++) {
        out[i] = p->w[i].m;
        out[4 + i] = p->w[i].duty;
    }
    out[15] = p->v;
    out[16] = p->vy;
    out[17] = p->om;
    out[18] = p->acc_x;
    out[19] = p->acc_y;
}

/* The state that the vectors hold beside the outputs: motor, speed and integral of four wheels. */
void plant_state(const struct plant *p, double *out)
{
    for (int i = 0; i < 4; i++) {
        out[i] = p->w[i].x;
        out[4 + i] = p->w[i].n;
        out[8 + i] = p->w[i].integral;
    }
}

/* --- sensors: run after plant_tick, every Ts ------------------------------------------------------ */

static double uniform(double seed, long counter, unsigned long long channel)
{
    unsigned long long h = 0, part[3] = {(unsigned long long)seed, (unsigned long long)counter, channel};
    for (int k = 0; k < 3; k++) { /* splitmix64 over the three words, one after the other */
        h = (k == 0 ? 0 : h) + part[k] + 0x9E3779B97F4A7C15ull;
        h = (h ^ (h >> 30)) * 0xBF58476D1CE4E5B9ull;
        h = (h ^ (h >> 27)) * 0x94D049BB133111EBull;
        h ^= h >> 31;
    }
    return ((double)(h >> 11) + 0.5) / 9007199254740992.0;
}

/* channel `what` of the past at an age in seconds; angles along the shorter way */
static double remembered(const struct plant *p, int what, double age_s, int angle)
{
    double age = fmin(age_s / p->Ts, (double)p->runs);
    if (fabs(age - round(age)) < 1e-9 * fmax(round(age), 1.0))
        age = round(age);
    long whole = (long)floor(age);
    double share = age - (double)whole;
    double a = p->past[(p->runs - whole) % RING][what];
    if (share == 0.0)
        return a;
    double d = p->past[(p->runs - whole - 1) % RING][what] - a;
    return angle ? wrapped(a + share * wrapped(d)) : a + share * d;
}

/* out: gyro, yaw, acceleration x, y of the inertial unit; x, y, yaw of the navigation tag */
void plant_sensors(struct plant *p, const double *tick_out, double *out)
{
    double *now = p->past[p->runs % RING];
    now[0] = tick_out[17];
    now[1] = tick_out[14];
    now[2] = tick_out[18];
    now[3] = tick_out[19];
    now[4] = tick_out[12];
    now[5] = tick_out[13];
    out[0] = (1.0 + p->gyro_a) * remembered(p, 0, p->imu_latency, 0) + p->gyro_bias;
    out[1] = remembered(p, 1, p->imu_latency, 1);
    out[2] = remembered(p, 2, p->imu_latency, 0);
    out[3] = remembered(p, 3, p->imu_latency, 0);
    if (p->runs % (long)p->nav_every == 0) {
        double x = remembered(p, 4, p->nav_latency, 0), y = remembered(p, 5, p->nav_latency, 0);
        double then = remembered(p, 1, p->nav_latency, 1);
        double yaw = remembered(p, 1, p->yaw_latency, 1);
        x += p->lever_x * cos(then) - p->lever_y * sin(then);
        y += p->lever_x * sin(then) + p->lever_y * cos(then);
        p->nav[0] = (1.0 + p->nav_scale) * x + p->bias * cos(2.0 * PI * y / p->bias_length);
        p->nav[1] = (1.0 + p->nav_scale) * y + p->bias * cos(2.0 * PI * x / p->bias_length);
        if (uniform(p->seed, p->samples, 40) < p->outlier_share) {
            double direction = 2.0 * PI * uniform(p->seed, p->samples, 41);
            p->nav[0] += p->outlier_size * cos(direction);
            p->nav[1] += p->outlier_size * sin(direction);
        }
        p->nav[2] = wrapped(yaw + p->dist_a1 * sin(yaw + p->dist_p1)
                            + p->dist_a2 * sin(2.0 * yaw + p->dist_p2) + p->frame_yaw);
        p->samples++;
    }
    memcpy(out + 4, p->nav, sizeof p->nav);
    p->runs++;
}

/* --- the speed comparison: a whole base tick with inputs, outputs and status codes --------------- */

#define STATUSES 18

static __attribute__((noinline)) void full_tick(struct plant *p, const double *u, double *y,
                                                long long *q)
{
    static const double zero[4];
    double s[4];
    if (u[14] != p->pose_request) {
        p->pose_request = u[14];
        p->X = u[15];
        p->Y = u[16];
        p->yaw = wrapped(u[17]);
    }
    if (u[13] != 0.0 || u[7] == 0.0) {
        memcpy(s, zero, sizeof s);
    } else if (u[6] == 0.0) {
        memcpy(s, u, sizeof s);
    } else {
        double straight = u[4] / p->r * 60.0 / (2.0 * PI);
        double turning = u[5] / (2.0 * p->yaw_sign * p->r * p->k_om) * 60.0 / (2.0 * PI);
        s[0] = s[1] = turning + straight;
        s[2] = s[3] = turning - straight;
    }
    double largest = fmax(fmax(fabs(s[0]), fabs(s[1])), fmax(fabs(s[2]), fabs(s[3])));
    if (largest > p->max_rpm)
        for (int i = 0; i < 4; i++)
            s[i] *= p->max_rpm / largest;
    for (int i = 0; i < STATUSES; i++)
        q[i] = 0;
    plant_tick(p, s, y);
}

void plant_run(struct plant *p, const double *u, double *y, long long *q, long ticks)
{
    for (long k = 0; k < ticks; k++)
        full_tick(p, u, y, q);
}
