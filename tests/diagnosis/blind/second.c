/* The second generator: a robot with hidden causes drives, or runs on the bench; its log is CSV.
 *
 *     second drive|bench SECONDS DRIVE_SEED NOISE_SEED [CAUSE=VALUE ...] > log.csv
 *
 * Written from the reference page of the plant alone: no code of the plant, none of the first
 * generator. Wheels, filters, body and pose are one system of differential equations under a sampled
 * controller, solved by Runge and Kutta's classical method.
 */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define STEP_S 0.00025
#define STEPS_PER_MS 4
#define WHEELS 4
#define LONGEST_S 1200.0
#define MOST_CAUSES 32
#define RAD_S (M_PI / 30.0)

static const double track_m = 0.31, wheelbase_m = 0.25, radius_m = 0.085, icr_m = 0.02;
static const double t2_s = 0.0023, rest_rpm = 0.05, top_rpm = 90.0;

/* --- what is hidden ------------------------------------------------------------------------- */

static const char *names[MOST_CAUSES];
static double values[MOST_CAUSES];
static int used[MOST_CAUSES], n_causes;

static double hidden(const char *name, double otherwise)
{
    for (int k = 0; k < n_causes; k++)
        if (strcmp(names[k], name) == 0) {
            used[k] = 1;
            return values[k];
        }
    return otherwise;
}

static struct {
    double gain, t1, limit, coulomb, viscous, dead, stribeck, stribeck_rpm, load[WHEELS], sag;
    double delay, rate, period, kp, ki, shown[WHEELS], filter, quantum;
    double left, right, k_om, k_speed, k_radius, slip, launch, traction, lag, side, icr, toe;
    double slope_x, slope_y, floor_k, floor_v, x_min, x_max, y_min, y_max, runout, runout_phase;
    double frame, arm_x, arm_y, late, yaw_late, scale, bias, wave, share, thrown;
    double once, once_phase, twice, twice_phase, gyro_bias, gyro_scale, imu_late;
    double swing, swing_period, swing_phase, drag, drag_phase, memory; /* no cause of the library */
} c;

static void read_causes(void)
{
    double radius = radius_m * (1.0 + hidden("wheel_radius", 0.0));
    double apart = hidden("wheel_radius_difference", 0.0);
    c.left = radius * (1.0 + 0.5 * apart), c.right = radius * (1.0 - 0.5 * apart);
    c.gain = 1.11 * (1.0 + hidden("process_gain", 0.0));
    c.t1 = 0.069 * (1.0 + hidden("time_constant", 0.0));
    c.limit = hidden("saturation_limit", 100.0);
    c.coulomb = hidden("coulomb_friction", 0.0), c.viscous = hidden("viscous_load", 0.0);
    c.dead = hidden("dead_zone", 0.0);
    c.stribeck = hidden("stribeck_friction.f_s", 0.0);
    c.stribeck_rpm = hidden("stribeck_friction.n_s", 6.0);
    c.load[(int)hidden("wheel_load.wheel", 0.0)] = hidden("wheel_load.f", 0.0);
    c.sag = hidden("battery_sag", 0.0);
    c.delay = hidden("actuation_delay", 0.0), c.rate = hidden("setpoint_rate_limit", 1e12);
    c.period = hidden("control_period", 0.001);
    c.kp = 13.513 * (1.0 + hidden("controller_gains.p", 0.0));
    c.ki = 195.84 * (1.0 + hidden("controller_gains.i", 0.0));
    for (int i = 0; i < WHEELS; i++)
        c.shown[i] = 1.0;
    c.shown[(int)hidden("encoder_scale.wheel", 0.0)] += hidden("encoder_scale.a", 0.0);
    c.filter = hidden("encoder_filter", 0.0), c.quantum = hidden("encoder_quantization", 0.0);
    c.k_om = track_m / (wheelbase_m * wheelbase_m + track_m * track_m);
    c.k_om *= 1.0 + hidden("rotation_gain", 0.0);
    c.k_speed = hidden("rotation_gain_speed", 0.0), c.k_radius = hidden("rotation_gain_radius", 0.0);
    c.slip = hidden("longitudinal_slip", 0.0), c.launch = hidden("acceleration_slip", 0.0);
    c.traction = hidden("traction_slip", 0.0), c.lag = hidden("body_lag", 0.0);
    c.side = hidden("side_slip", 0.0), c.icr = icr_m + hidden("icr_offset", 0.0);
    c.toe = hidden("wheel_misalignment", 0.0);
    c.slope_x = hidden("floor_slope.x", 0.0), c.slope_y = hidden("floor_slope.y", 0.0);
    c.floor_k = hidden("surface_change.k_om", 0.0), c.floor_v = hidden("surface_change.v", 0.0);
    c.x_min = hidden("surface_change.x_min", 0.0), c.x_max = hidden("surface_change.x_max", 1e3);
    c.y_min = hidden("surface_change.y_min", -1e3), c.y_max = hidden("surface_change.y_max", 1e3);
    c.runout = hidden("wheel_runout.amplitude", 0.0);
    c.runout_phase = hidden("wheel_runout.phase", 0.0);
    c.frame = hidden("nav_frame_yaw", 0.0), c.scale = 1.0 + hidden("nav_scale", 0.0);
    c.arm_x = hidden("nav_lever_arm.x", 0.0), c.arm_y = hidden("nav_lever_arm.y", 0.0);
    c.late = hidden("nav_latency", 0.0), c.yaw_late = hidden("yaw_latency", 0.0);
    c.bias = hidden("nav_position_bias.amplitude", 0.0);
    c.wave = 2.0 * M_PI / hidden("nav_position_bias.wavelength", 5.0);
    c.share = hidden("nav_outliers.share", 0.0), c.thrown = hidden("nav_outliers.size", 1.5);
    c.once = hidden("heading_distortion.a1", 0.0);
    c.once_phase = hidden("heading_distortion.phase1", 0.0);
    c.twice = hidden("heading_distortion.a2", 0.0);
    c.twice_phase = hidden("heading_distortion.phase2", 0.0);
    c.gyro_bias = hidden("gyro_bias", 0.0), c.gyro_scale = 1.0 + hidden("gyro_scale", 0.0);
    c.imu_late = hidden("imu_latency", 0.0);
    c.swing = hidden("periodic.turn", 0.0), c.swing_period = hidden("periodic.period", 10.0);
    c.swing_phase = hidden("periodic.phase", 0.0);
    c.drag = hidden("cable_drag.turn", 0.0), c.drag_phase = hidden("cable_drag.phase", 0.0);
    c.memory = hidden("hysteresis", 0.0);
}

/* --- random numbers: xorshift64*, a stream of its own for every purpose ---------------------------- */

typedef uint64_t Stream;

static Stream stream(uint64_t seed, uint64_t purpose)
{
    Stream s = (seed + 1) * 0x9E3779B97F4A7C15u ^ (purpose + 1) * 0xD1B54A32D192ED03u;
    s ^= s >> 31, s *= 0xBF58476D1CE4E5B9u, s ^= s >> 29;
    return s ? s : 1;
}

static double uniform(Stream *s, double low, double high)
{
    *s ^= *s >> 12, *s ^= *s << 25, *s ^= *s >> 27;
    return low + (high - low) * ((double)((*s * 0x2545F4914F6CDD1Du) >> 11) / 9007199254740992.0);
}

static double normal(Stream *s)
{
    double a, b, r;
    do {
        a = uniform(s, -1.0, 1.0), b = uniform(s, -1.0, 1.0), r = a * a + b * b;
    } while (r >= 1.0 || r == 0.0);
    return a * sqrt(-2.0 * log(r) / r);
}

static double sign_of(Stream *s) { return uniform(s, 0.0, 1.0) < 0.5 ? -1.0 : 1.0; }

/* --- the machine: motor, speed and filter of every wheel; x, y, yaw; v, om; angle of the left wheels */

enum { MOTOR, SPEED = 4, SEEN = 8, X = 12, Y, YAW, V, OM, ANGLE, STATES };

static double duty[WHEELS], voltage, heading_of_travel = 1.0;

static double load(int i, double u, double rpm)
{
    u = copysign(fmax(fabs(u) - c.dead, 0.0), u);
    double friction = c.coulomb + c.load[i] + c.stribeck * exp(-pow(rpm / c.stribeck_rpm, 2.0));
    if (fabs(rpm) >= rest_rpm)
        return u - copysign(friction, rpm);
    return fabs(u) <= friction ? 0.0 : u - copysign(friction, u);
}

/* Speed, turn rate and lateral speed that the wheels make of the body. */
static void body(const double *s, double t, double *v, double *om, double *across)
{
    double w_l = 0.5 * (s[SPEED] + s[SPEED + 1]) * RAD_S;
    double w_r = 0.5 * (s[SPEED + 2] + s[SPEED + 3]) * RAD_S;
    double r_l = c.left * (1.0 + c.runout * sin(s[ANGLE] + c.runout_phase));
    double v0 = 0.5 * (r_l * w_l - c.right * w_r), k = c.k_om * (1.0 + c.k_speed * fabs(v0));
    if (c.k_radius != 0.0) {
        double nominal = track_m / (wheelbase_m * wheelbase_m + track_m * track_m);
        double turn = 0.5 * track_m * nominal * radius_m * fabs(w_l + w_r);
        if (fabs(v0) + turn > 0.0)
            k *= 1.0 + c.k_radius * fabs(v0) / (fabs(v0) + turn);
    }
    int inside = s[X] >= c.x_min && s[X] <= c.x_max && s[Y] >= c.y_min && s[Y] <= c.y_max;
    if (inside)
        k *= 1.0 + c.floor_k;
    double made_om = -k * (r_l * w_l + c.right * w_r);
    double made_v = v0 * (1.0 - c.traction) * (1.0 - c.slip * fabs(made_om));
    if (inside)
        made_v *= 1.0 + c.floor_v;
    if (c.launch != 0.0) {
        double a_l = 0.5 * (s[MOTOR] - s[SPEED] + s[MOTOR + 1] - s[SPEED + 1]) / t2_s * RAD_S;
        double a_r = 0.5 * (s[MOTOR + 2] - s[SPEED + 2] + s[MOTOR + 3] - s[SPEED + 3]) / t2_s * RAD_S;
        made_v *= fmax(0.0, 1.0 - c.launch * fabs(0.5 * (c.left * a_l - c.right * a_r)));
    }
    *v = made_v, *om = made_om;
    if (c.lag > 0.0)
        *v = s[V], *om = s[OM];
    *om *= 1.0 + c.drag * cos(s[YAW] - c.drag_phase) + c.memory * heading_of_travel;
    if (fabs(w_l) + fabs(w_r) > 0.05)
        *om += c.swing * sin(2.0 * M_PI * t / c.swing_period + c.swing_phase);
    *across = -c.icr * *om + c.side * *v * *om + c.toe * *v;
}

static void rates(const double *s, double t, double *d)
{
    double gain = c.gain * fmax(1.0 + c.sag * (voltage / 19.2 - 1.0), 0.0);
    for (int i = 0; i < WHEELS; i++) {
        double u = load(i, duty[i], s[SPEED + i]);
        d[MOTOR + i] = (gain * (u - c.viscous * s[SPEED + i]) - s[MOTOR + i]) / c.t1;
        d[SPEED + i] = (s[MOTOR + i] - s[SPEED + i]) / t2_s;
        d[SEEN + i] = c.filter > 0.0 ? (s[SPEED + i] - s[SEEN + i]) / c.filter : 0.0;
    }
    double v, om, across, lag = c.lag;
    c.lag = 0.0, body(s, t, &v, &om, &across), c.lag = lag;
    d[V] = lag > 0.0 ? (v - s[V]) / lag : 0.0, d[OM] = lag > 0.0 ? (om - s[OM]) / lag : 0.0;
    body(s, t, &v, &om, &across);
    d[X] = v * cos(s[YAW]) - across * sin(s[YAW]);
    d[Y] = v * sin(s[YAW]) + across * cos(s[YAW]);
    d[YAW] = om;
    d[ANGLE] = 0.5 * (s[SPEED] + s[SPEED + 1]) * RAD_S;
    double turning = fabs(s[SPEED] + s[SPEED + 1]) + fabs(s[SPEED + 2] + s[SPEED + 3]);
    if (0.5 * turning * RAD_S > 0.05)
        d[X] += c.slope_x, d[Y] += c.slope_y;
}

static void advance(double *s, double t)
{
    double k1[STATES], k2[STATES], k3[STATES], k4[STATES], at[STATES];
    rates(s, t, k1);
    for (int j = 0; j < STATES; j++) at[j] = s[j] + 0.5 * STEP_S * k1[j];
    rates(at, t + 0.5 * STEP_S, k2);
    for (int j = 0; j < STATES; j++) at[j] = s[j] + 0.5 * STEP_S * k2[j];
    rates(at, t + 0.5 * STEP_S, k3);
    for (int j = 0; j < STATES; j++) at[j] = s[j] + STEP_S * k3[j];
    rates(at, t + STEP_S, k4);
    for (int j = 0; j < STATES; j++) s[j] += STEP_S / 6.0 * (k1[j] + 2.0 * (k2[j] + k3[j]) + k4[j]);
}

static double seen(const double *s, int i)
{
    double rpm = c.shown[i] * (c.filter > 0.0 ? s[SEEN + i] : s[SPEED + i]);
    return c.quantum > 0.0 ? c.quantum * floor(rpm / c.quantum + 0.5) : rpm;
}

static void control(const double *s, const double *aim, double *integral)
{
    for (int i = 0; i < WHEELS; i++) {
        double error = aim[i] - seen(s, i), wanted = c.kp * error + integral[i];
        duty[i] = fmin(fmax(wanted, -c.limit), c.limit);
        integral[i] += c.period * (c.ki * error + sqrt(195.84) * (duty[i] - wanted));
    }
}

/* --- who asks the wheels for what ------------------------------------------------------------- */

static struct { double left, right, until_s, until_rad, slew, turned, last_yaw; } leg;

static void next_leg(Stream *s, double t, const double *state)
{
    double pick = uniform(s, 0.0, 1.0), rpm = uniform(s, 15.0, top_rpm);
    double to_middle = -(state[X] * cos(state[YAW]) + state[Y] * sin(state[YAW]));
    int far = hypot(state[X], state[Y]) > 2.0;
    double way = far ? copysign(1.0, to_middle) : sign_of(s);
    leg.until_rad = 1e9, leg.turned = 0.0, leg.last_yaw = state[YAW];
    leg.slew = uniform(s, 0.0, 1.0) < 0.6 ? 1e6 : uniform(s, 60.0, 400.0);
    if (pick < 0.15) {
        leg.left = leg.right = 0.0, leg.until_s = t + uniform(s, 0.3, 1.5);
    } else if (pick < 0.45) {
        leg.left = leg.right = way * rpm, leg.until_s = t + uniform(s, 1.0, 4.0);
    } else if (pick < 0.7) {
        double inner = rpm * uniform(s, 0.0, 0.9);
        int left_is_inner = uniform(s, 0.0, 1.0) < 0.5;
        leg.left = way * (left_is_inner ? inner : rpm), leg.right = way * (left_is_inner ? rpm : inner);
        leg.until_s = t + uniform(s, 1.5, 5.0);
    } else {
        leg.right = uniform(s, 12.0, 60.0) * sign_of(s), leg.left = -leg.right;
        leg.until_rad = uniform(s, 0.5, 7.5), leg.until_s = t + 20.0;
    }
}

static double towards(double now, double goal, double most)
{
    return fmin(fmax(goal, now - most), now + most);
}

static void drive(Stream *s, double t, double since_s, const double *state, double *asked)
{
    leg.turned += fabs(state[YAW] - leg.last_yaw), leg.last_yaw = state[YAW];
    if (t >= leg.until_s || leg.turned >= leg.until_rad)
        next_leg(s, t, state);
    asked[0] = asked[1] = towards(asked[0], leg.left, leg.slew * since_s);
    asked[2] = asked[3] = -towards(-asked[2], leg.right, leg.slew * since_s);
}

static void bench(Stream *s, double t, double *until, double *asked, int together)
{
    for (int i = 0; i < WHEELS; i++) {
        if (together && i > 0) {
            asked[i] = i < 2 ? asked[0] : -asked[0];
        } else if (t >= until[i]) {
            double pick = uniform(s, 0.0, 1.0), now = asked[i];
            if (pick < 0.3)
                now = uniform(s, 20.0, top_rpm) * sign_of(s);
            else if (pick < 0.5)
                now = fmin(fmax(now + uniform(s, 1.0, 5.0) * sign_of(s), -top_rpm), top_rpm);
            else if (pick < 0.65)
                now = uniform(s, 0.3, 5.0) * sign_of(s);
            else
                now = pick < 0.85 ? -now : 0.0;
            asked[i] = now, until[i] = t + uniform(s, 0.2, 2.0);
        }
    }
}

/* --- what is written down --------------------------------------------------------------------- */

static double *past[4]; /* x, y, yaw, om, every millisecond */

static double back_then(int what, double t)
{
    double at = fmax(t, 0.0) * 1e3;
    long k = (long)at;
    return past[what][k] + (at - (double)k) * (past[what][k + 1] - past[what][k]);
}

static void cell(Stream *s, double value)
{
    if (uniform(s, 0.0, 1.0) >= 0.002)
        printf(",%.7g", value);
    else
        putchar(',');
}

static void slow_noise(Stream *s, double *state, double since_s, double sd, double correlation_s)
{
    double keep = since_s < 0.0 ? 0.0 : exp(-since_s / correlation_s);
    *state = keep * *state + sd * sqrt(1.0 - keep * keep) * normal(s);
}

static void navigation(Stream *s, Stream *gaps, double t, double *slow, double since_s)
{
    double x0 = back_then(0, t - c.late), y0 = back_then(1, t - c.late);
    double yaw0 = back_then(2, t - c.late), yaw = back_then(2, t - c.yaw_late);
    x0 += c.arm_x * cos(yaw0) - c.arm_y * sin(yaw0), y0 += c.arm_x * sin(yaw0) + c.arm_y * cos(yaw0);
    slow_noise(s, &slow[0], since_s, 0.05, 0.6), slow_noise(s, &slow[1], since_s, 0.05, 0.6);
    slow_noise(s, &slow[2], since_s, 0.015, 2.0);
    double x = c.scale * x0 + c.bias * cos(c.wave * y0) + slow[0] + 0.01 * normal(s);
    double y = c.scale * y0 + c.bias * cos(c.wave * x0) + slow[1] + 0.01 * normal(s);
    if (uniform(s, 0.0, 1.0) < c.share) {
        double aside = uniform(s, 0.0, 2.0 * M_PI);
        x += c.thrown * cos(aside), y += c.thrown * sin(aside);
    }
    double shown = yaw + c.once * sin(yaw + c.once_phase) + c.twice * sin(2.0 * yaw + c.twice_phase);
    cell(gaps, x), cell(gaps, y);
    cell(gaps, remainder(shown + c.frame + slow[2], 2.0 * M_PI));
}

int main(int argc, char **argv)
{
    if (argc < 5 || argc > 5 + MOST_CAUSES) {
        fprintf(stderr, "usage: %s drive|bench SECONDS DRIVE_SEED NOISE_SEED [CAUSE=VALUE ...]\n", argv[0]);
        return 2;
    }
    int drives = strcmp(argv[1], "drive") == 0;
    double length_s = fmin(atof(argv[2]), LONGEST_S);
    uint64_t drive_seed = strtoull(argv[3], NULL, 10), noise_seed = strtoull(argv[4], NULL, 10);
    for (int k = 5; k < argc; k++) {
        char *value = strchr(argv[k], '=');
        if (value == NULL)
            return 2;
        *value = '\0', names[n_causes] = argv[k], values[n_causes++] = atof(value + 1);
    }
    read_causes();
    for (int k = 0; k < n_causes; k++)
        if (!used[k]) {
            fprintf(stderr, "%s: not a cause that this program can hide\n", names[k]);
            return 2;
        }
    long n_ms = (long)(length_s * 1e3), row_ms = drives ? 20 : 2;
    for (int j = 0; j < 4; j++)
        past[j] = calloc((size_t)n_ms + 3, sizeof(double));
    double(*sent)[WHEELS] = calloc((size_t)(n_ms / row_ms) + 2, sizeof *sent);
    long *sent_ms = calloc((size_t)(n_ms / row_ms) + 2, sizeof(long));
    Stream driver = stream(drive_seed, 0), rows = stream(noise_seed, 1), wheels = stream(noise_seed, 2);
    Stream gyro = stream(noise_seed, 3), tag = stream(noise_seed, 4), gaps = stream(noise_seed, 5);
    Stream volts = stream(noise_seed, 6);
    double s[STATES] = {0}, aim[WHEELS] = {0}, integral[WHEELS] = {0}, asked[WHEELS] = {0};
    double until[WHEELS] = {0.5, 0.5, 0.5, 0.5}, slow[3] = {0}, next_control = 0.0, last_nav_s = -1.0;
    double charge = uniform(&driver, 0.45, 0.95);
    int together = uniform(&driver, 0.0, 1.0) < 0.5;
    s[X] = uniform(&driver, -2.0, 2.0), s[Y] = uniform(&driver, -2.0, 2.0);
    s[YAW] = uniform(&driver, -M_PI, M_PI);
    leg.until_s = 0.8, leg.until_rad = 1e9, leg.last_yaw = s[YAW], leg.slew = 1e6;
    long n_rows = 0, next_row = 0, arrived = -1;
    static const char *which[WHEELS] = {"fl", "rl", "fr", "rr"};
    printf("t_s");
    for (int i = 0; i < WHEELS; i++) printf(",wheel.%s.setpoint_rpm", which[i]);
    for (int i = 0; i < WHEELS; i++) printf(",wheel.%s.speed_rpm", which[i]);
    for (int i = 0; i < WHEELS; i++) printf(",wheel.%s.duty_pct", which[i]);
    printf(drives ? ",imu.gyro_z_rad_s,nav.x_m,nav.y_m,nav.yaw_rad" : "");
    printf(",battery.voltage_v\n");
    for (long ms = 0; ms < n_ms; ms++) {
        double t = 1e-3 * (double)ms, v, om, across, current = 0.7;
        int at_row = ms == next_row;
        if (at_row) {
            double since_s = n_rows > 0 ? t - 1e-3 * (double)sent_ms[n_rows - 1] : 0.0;
            if (drives)
                drive(&driver, t, since_s, s, asked);
            else
                bench(&driver, t, until, asked, together);
            memcpy(sent[n_rows], asked, sizeof asked), sent_ms[n_rows++] = ms;
            double jitter = drives ? fmin(fmax(normal(&rows), -4.0), 4.0) : 0.0;
            next_row = n_rows * row_ms + lround(jitter);
        }
        for (int i = 0; i < WHEELS; i++)
            current += 0.013 * fabs(duty[i]);
        voltage = 18.4 + 3.1 * charge - 0.11 * current, charge -= current * 1e-3 / (3.0 * 3600.0);
        if (fabs(s[SPEED] - s[SPEED + 2]) > 20.0)
            heading_of_travel = copysign(1.0, s[SPEED] - s[SPEED + 2]);
        body(s, t, &v, &om, &across);
        past[0][ms] = s[X], past[1][ms] = s[Y], past[2][ms] = s[YAW], past[3][ms] = om;
        for (int j = 0; j < 4; j++) past[j][ms + 1] = past[j][ms];
        for (int part = 0; part < STEPS_PER_MS; part++) {
            double now = t + part * STEP_S;
            while (arrived + 1 < n_rows && 1e-3 * (double)sent_ms[arrived + 1] + c.delay <= now + 1e-9)
                arrived++;
            if (now >= next_control - 1e-9) {
                next_control += c.period;
                for (int i = 0; i < WHEELS && arrived >= 0; i++)
                    aim[i] = towards(aim[i], sent[arrived][i], c.rate * c.period);
                control(s, aim, integral);
            }
            if (part == 0 && at_row) {
                printf("%.6f", t);
                for (int i = 0; i < WHEELS; i++) printf(",%.7g", asked[i]);
                for (int i = 0; i < WHEELS; i++) cell(&gaps, seen(s, i) + 0.12 * normal(&wheels));
                for (int i = 0; i < WHEELS; i++) cell(&gaps, duty[i] + 0.15 * normal(&wheels));
                if (drives) {
                    double rate = c.gyro_scale * back_then(3, t - c.imu_late) + c.gyro_bias;
                    cell(&gaps, rate + 0.006 * normal(&gyro));
                    double since_s = last_nav_s < 0.0 ? -1.0 : t - last_nav_s;
                    if (last_nav_s < 0.0 || floor(t * 20.0 + 1e-9) > floor(last_nav_s * 20.0 + 1e-9))
                        navigation(&tag, &gaps, t, slow, since_s), last_nav_s = t;
                    else
                        printf(",,,");
                }
                cell(&gaps, voltage + 0.02 * normal(&volts));
                putchar('\n');
            }
            advance(s, now);
        }
    }
    return 0;
}
