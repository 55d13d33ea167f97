/* Drives and train of the simulator: machine, wheel on rail, controls and driver.
 *
 * Sine, cosine, exponential and arc tangent are those of libm: simulated data are recorded and
 * decide no flag. No function here can fail: divisors are constants above 0 of motor and train, or
 * have a floor above 0; no index is computed, and no number is converted to an integer. */
#include "sim/physics/plant.h"

#include <math.h>

static const double PI = 3.14159265358979323846;
static const double NO_LIMIT_NM = 1e30;
static const double CURRENT_BANDWIDTH = 1200.0; /* rad/s */
static const double SPEED_BANDWIDTH = 120.0;    /* rad/s */
static const double SPEED_RATE = 30.0;          /* 1/s, of the speed control's integrator */
static const double DRIVER_BANDWIDTH = 1.0;     /* rad/s */
static const double CREEP_BAND_RAD_S = 0.5;     /* least band that a slip limiter allows */
static const double DC_SOURCE_OHM = 0.2;

static double smaller(double a, double b)
{
    return b < a ? b : a;
}

static double larger(double a, double b)
{
    return b > a ? b : a;
}

static double within(double x, double limit)
{
    return smaller(larger(x, -limit), limit);
}

/* ---- wheel on rail */

double sim_creep_torque(const struct sim_contact *contact, double slide)
{
    const struct sim_rail *rail = &contact->rail;
    const double w = fabs(slide);
    const double s = w / larger(fabs(contact->v_m_s), contact->speed_floor_m_s);
    const double mu = rail->mu_0 * ((1.0 - rail->A) * exp(-rail->B * w) + rail->A);
    const double eps = rail->k_c * s / mu;
    const double x = rail->k_A * eps;
    const double shape = x / (1.0 + x * x) + atan(rail->k_S * eps);
    const double torque = contact->weight_nm * (2.0 / PI) * mu * shape;
    return slide >= 0.0 ? torque : -torque;
}

/* Creep torque of a wheel, limited to what an adhesion loss leaves. */
static double rail_torque(const struct sim_contact *contact, double w_m)
{
    const double slide = w_m * contact->radius_m - contact->v_m_s;
    return within(sim_creep_torque(contact, slide), contact->limit_nm);
}

/* ---- machine */

struct rates {
    double i_alpha; /* A/s */
    double i_beta;  /* A/s */
    double torque;  /* Nm, of the air gap */
};

/* L_s di/dt = u - R_s i - psi_pm w_e [-sin theta, cos theta]
 * T         = k_p pp psi_pm (i_beta cos theta - i_alpha sin theta)
 *
 * With phase a open (star point isolated) i_alpha = i_a keeps its value, 0, and the voltage across
 * b and c, which is u_beta, drives i_beta as before. */
static struct rates machine(const struct sim_motor *m, const double y[4], double u_alpha,
                            double u_beta)
{
    const double i_alpha = y[0], i_beta = y[1], w_m = y[2], theta = y[3];
    const double sine = sin(theta), cosine = cos(theta);
    const double w_e = m->pole_pairs * w_m;
    struct rates rates = {0.0, 0.0, 0.0};
    if (m->phase_a_open == 0.0)
        rates.i_alpha = (u_alpha - m->R_s * i_alpha + m->psi_pm * w_e * sine) / m->L_s;
    rates.i_beta = (u_beta - m->R_s * i_beta - m->psi_pm * w_e * cosine) / m->L_s;
    rates.torque = m->k_p * m->pole_pairs * m->psi_pm * (i_beta * cosine - i_alpha * sine);
    return rates;
}

/* Torque of the friction brake. At standstill it opposes the torque that would turn the wheel;
 * *locked: 1 if that torque is no larger than the brake can hold. */
static double brake_torque(const struct sim_motor *m, const struct sim_contact *contact,
                           const double y[4], double u_alpha, double u_beta, int *locked)
{
    double turning = y[2];
    *locked = 0;
    if (!(m->brake_nm > 0.0))
        return 0.0;
    if (y[2] == 0.0) {
        turning = machine(m, y, u_alpha, u_beta).torque - rail_torque(contact, y[2]);
        *locked = fabs(turning) <= m->brake_nm;
    }
    return copysign(m->brake_nm, turning);
}

/* One Runge-Kutta step; y: i_alpha, i_beta, w_m, theta_e. */
static void step(const struct sim_motor *m, const struct sim_contact *contact, double u_alpha,
                 double u_beta, double h, double y[4])
{
    static const double AHEAD[4] = {0.0, 0.5, 0.5, 1.0}, WEIGHT[4] = {1.0, 2.0, 2.0, 1.0};
    int locked;
    const double brake = brake_torque(m, contact, y, u_alpha, u_beta, &locked);
    const double w_before = y[2], theta_before = y[3];
    double sum[4] = {0.0, 0.0, 0.0, 0.0}, rate[4] = {0.0, 0.0, 0.0, 0.0};
    for (int stage = 0; stage < 4; stage++) {
        double at[4];
        for (int j = 0; j < 4; j++)
            at[j] = y[j] + AHEAD[stage] * h * rate[j];
        const struct rates rates = machine(m, at, u_alpha, u_beta);
        const double load = contact->on_rail ? rail_torque(contact, at[2]) : contact->load_nm;
        rate[0] = rates.i_alpha;
        rate[1] = rates.i_beta;
        rate[2] = (rates.torque - load - brake - m->B * at[2]) / m->J;
        rate[3] = m->pole_pairs * at[2];
        for (int j = 0; j < 4; j++)
            sum[j] += WEIGHT[stage] * rate[j];
    }
    for (int j = 0; j < 4; j++)
        y[j] += h / 6.0 * sum[j];
    if (m->brake_nm > 0.0 && (locked || w_before * y[2] < 0.0)) {
        y[2] = 0.0;
        y[3] = theta_before;
    }
}

void sim_integrate(const struct sim_motor *motor, const struct sim_contact *contact, double u_alpha,
                   double u_beta, double h, int64_t steps, struct sim_drive *drive)
{
    const double turn = 2.0 * PI;
    const double i_alpha = motor->phase_a_open != 0.0 ? 0.0 : drive->i_alpha;
    double y[4] = {i_alpha, drive->i_beta, drive->w_m, drive->theta_e};
    for (int64_t k = 0; k < steps; k++)
        step(motor, contact, u_alpha, u_beta, h, y);
    drive->i_alpha = y[0];
    drive->i_beta = y[1];
    drive->w_m = y[2];
    drive->theta_e = y[3] - turn * floor(y[3] / turn);
}

/* ---- controls of a drive */

/* Field-oriented PI control with decoupling; its voltage is applied in the next period. Above
 * u_max the voltage is scaled back, and the integrators are held. */
static void control_current(const struct sim_motor *m, double torque_ref, double u_max, double dt,
                            struct sim_drive *d)
{
    const double sine = sin(d->theta_e), cosine = cos(d->theta_e);
    const double w_e = m->pole_pairs * d->w_m;
    const double i_d = d->i_alpha * cosine + d->i_beta * sine;
    const double i_q = d->i_beta * cosine - d->i_alpha * sine;
    const double error_d = -i_d;
    const double error_q = torque_ref / (m->k_p * m->pole_pairs * m->psi_pm_control) - i_q;
    const double gain = CURRENT_BANDWIDTH * m->L_s;
    double u_d = gain * error_d + d->v_d - w_e * m->L_s * i_q;
    double u_q = gain * error_q + d->v_q + w_e * (m->L_s * i_d + m->psi_pm);
    const double size = hypot(u_d, u_q);
    if (size > u_max) { /* so it is above 0 */
        u_d *= u_max / size;
        u_q *= u_max / size;
    } else {
        d->v_d += CURRENT_BANDWIDTH * m->R_s * error_d * dt;
        d->v_q += CURRENT_BANDWIDTH * m->R_s * error_q * dt;
    }
    /* Computed now, applied one period later: turn to that period's middle. */
    const double ahead = d->theta_e + 1.5 * w_e * dt;
    d->u_alpha = u_d * cos(ahead) - u_q * sin(ahead);
    d->u_beta = u_d * sin(ahead) + u_q * cos(ahead);
}

/* Torque reference, Nm: the command, unless the wheel leaves the creep band. Only a command can
 * be limited: a motor that coasts has no effect on a wheel that slides. */
static double limit_slip(const struct sim_motor *m, double command, double w_train, double dt,
                         struct sim_drive *d)
{
    if (command == 0.0)
        d->integral_nm = 0.0;
    if (command == 0.0 || isinf(m->creep_max))
        return command;
    const double band = larger(m->creep_max * fabs(w_train), CREEP_BAND_RAD_S);
    const double gain = m->slip_bandwidth * m->J;
    const double error = command >= 0.0 ? w_train + band - d->w_m : w_train - band - d->w_m;
    const double low = smaller(0.0, command), high = larger(0.0, command);
    d->integral_nm += m->slip_rate * gain * error * dt;
    d->integral_nm = smaller(larger(d->integral_nm, low), high);
    const double wanted = gain * error + d->integral_nm;
    if (command >= 0.0)
        return larger(smaller(command, wanted), -0.5 * m->T_max);
    return smaller(larger(command, wanted), 0.5 * m->T_max);
}

/* Torque reference, Nm, of a PI speed control with clamped integrator. */
static double control_speed(const struct sim_motor *m, double w_ref, double dt, struct sim_drive *d)
{
    const double gain = SPEED_BANDWIDTH * m->J;
    const double error = w_ref - d->w_m;
    d->integral_nm += SPEED_RATE * gain * error * dt;
    d->integral_nm = within(d->integral_nm, m->T_max);
    return within(gain * error + d->integral_nm, m->T_max);
}

/* Level of the torque limiter after one period. */
static double next_limiter(const struct sim_train *train, double now, int cut, double floor_level)
{
    if (cut)
        return larger(now - train->cut_per_s * train->dt_s, floor_level);
    return smaller(now + train->restore_per_s * train->dt_s, 1.0);
}

/* ---- driver and train */

/* Torque demand on each drive, Nm, of a driver who keeps the speed. */
static double driver_demand(struct sim_train *train, double effort, int braking, double w_ref,
                            double w_acc)
{
    const double error = w_ref - train->w_m;
    const double gain = DRIVER_BANDWIDTH * train->inertia;
    double demand = gain * error + train->integral_nm + train->inertia * w_acc;
    if (braking) {
        const double fall = train->cut_per_s * train->dt_s * effort;
        demand = train->demand_nm - within(train->demand_nm, fall);
    } else if (fabs(demand) < effort) {
        train->integral_nm += 0.5 * DRIVER_BANDWIDTH * gain * error * train->dt_s;
    }
    return within(demand, effort);
}

/* Load of a wheel in this period. */
static struct sim_contact contact_of(const struct sim_train *train, const struct sim_motor *m,
                                     const struct sim_rail *rail, double carry, double limiter)
{
    const double demand = train->demand_nm * m->share;
    struct sim_contact contact = {
        .rail = *rail,
        .load_nm = demand * smaller(limiter, carry),
        .v_m_s = train->w_m * train->radius_m,
        .radius_m = train->radius_m * m->wheel,
        .weight_nm = train->weight_nm * m->share,
        .limit_nm = NO_LIMIT_NM,
        .speed_floor_m_s = train->speed_floor_m_s,
        .on_rail = train->on_rail,
    };
    if (train->on_rail && carry < 1.0)
        contact.limit_nm = carry * fabs(demand - copysign(m->brake_nm, train->w_m));
    return contact;
}

/* One drive by one period, at index `at` of the schedule; returns the load at the nominal wheel. */
static double advance_drive(const struct sim_train *train, const struct sim_motor *m,
                            const struct sim_schedule *schedule, int64_t period, int64_t at,
                            struct sim_drive *d, double *out)
{
    d->limiter = next_limiter(train, d->limiter, schedule->cut[at], m->cut_level);
    double command = train->demand_nm * d->limiter, reference;
    if (train->on_rail) {
        reference = limit_slip(m, command * m->share, train->w_m / m->wheel, train->dt_s, d);
    } else {
        command += m->J * schedule->w_acc[period];
        reference = control_speed(m, schedule->w_ref[period] / m->wheel, train->dt_s, d);
    }
    const struct sim_contact contact =
        contact_of(train, m, &schedule->rail[at], schedule->carry[at], d->limiter);
    const double u_alpha = d->u_alpha, u_beta = d->u_beta;
    const double power = 1.5 * (u_alpha * d->i_alpha + u_beta * d->i_beta);
    const double dc = train->u_dc - DC_SOURCE_OHM * power / train->u_dc;
    control_current(m, reference, dc / sqrt(3.0), train->dt_s, d);
    const double h = train->dt_s / (double)train->steps;
    sim_integrate(m, &contact, u_alpha, u_beta, h, train->steps, d);
    const double load = train->on_rail ? rail_torque(&contact, d->w_m) : contact.load_nm;
    const double i_q = d->i_beta * cos(d->theta_e) - d->i_alpha * sin(d->theta_e);
    out[OUT_I_ALPHA] = d->i_alpha;
    out[OUT_I_BETA] = d->i_beta;
    out[OUT_U_ALPHA] = u_alpha;
    out[OUT_U_BETA] = u_beta;
    out[OUT_U_DC] = dc;
    out[OUT_TORQUE] = m->k_p * m->pole_pairs * m->psi_pm * i_q;
    out[OUT_SPEED] = d->w_m;
    out[OUT_ANGLE] = d->theta_e;
    out[OUT_LOAD] = load;
    out[OUT_COMMAND] = command;
    return load / m->wheel;
}

void sim_advance(struct sim_train *train, const struct sim_motor *motors, struct sim_drive *drives,
                 const struct sim_schedule *schedule, double *out)
{
    const int64_t n = schedule->drives;
    int braking = 1;
    for (int64_t d = 0; d < n; d++)
        braking &= motors[d].brake_nm > 0.0;
    for (int64_t k = 0; k < schedule->periods; k++) {
        const double w_ref = schedule->w_ref[k], w_acc = schedule->w_acc[k];
        const double load = schedule->load_nm[k];
        if (train->on_rail)
            train->demand_nm = driver_demand(train, motors[0].effort_nm, braking, w_ref, w_acc);
        else
            train->demand_nm = load;
        double pull = 0.0;
        for (int64_t d = 0; d < n; d++) {
            const int64_t at = k * n + d;
            pull += advance_drive(train, &motors[d], schedule, k, at, &drives[d],
                                  &out[at * OUT_COLUMNS]);
        }
        if (train->on_rail)
            train->w_m += train->dt_s * (pull / (double)n - load) / train->inertia;
        else
            train->w_m = w_ref;
    }
}
