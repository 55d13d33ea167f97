/* Records of the simulator: one line per field, with unit and meaning.
 *
 * As gateway/core/records.h, and apart from it: no source of the core includes this file, so what is
 * true cannot reach an estimate. */
#ifndef TRACTION_SIM_RECORDS_H
#define TRACTION_SIM_RECORDS_H

#include <stdint.h>

#define SIM_NODES 6 /* of a motor's thermal network */

/* Columns of what the plant gives of each drive. */
enum plant_output {
    OUT_I_ALPHA = 0, /* A */
    OUT_I_BETA = 1,  /* A */
    OUT_U_ALPHA = 2, /* V, the mean of the last period */
    OUT_U_BETA = 3,  /* V */
    OUT_U_DC = 4,    /* V */
    OUT_TORQUE = 5,  /* Nm, of the air gap */
    OUT_SPEED = 6,   /* rad/s, of the rotor */
    OUT_ANGLE = 7,   /* rad, electrical, 0 to 2 pi */
    OUT_LOAD = 8,    /* Nm, at the rotor */
    OUT_COMMAND = 9, /* Nm, as the drive reports it */
    OUT_COLUMNS = 10,
};

/* One drive; the first seven are the motor's. */
struct sim_motor {
    double R_s;            /* ohm */
    double L_s;            /* H */
    double psi_pm;         /* Wb */
    double pole_pairs;     /* 1 */
    double J;              /* kg m2, of all that turns with the rotor */
    double B;              /* Nm s/rad */
    double k_p;            /* 1, T = k_p pole_pairs psi_pm i_q */
    double T_max;          /* Nm */
    double cut_level;      /* 0 to 1, what the torque limiter falls to */
    double share;          /* of the train's demand that falls to this drive */
    double wheel;          /* diameter over the nominal one */
    double phase_a_open;   /* 1: phase a is open; else 0 */
    double psi_pm_control; /* Wb, that the drive's own control believes in */
    double effort_nm;      /* most that the driver demands; the first drive's counts */
    double creep_max;      /* creep that the slip limiter allows; infinite: there is none */
    double slip_bandwidth; /* rad/s, of the slip limiter */
    double slip_rate;      /* 1/s, of its integrator */
    double brake_nm;       /* torque of the friction brake at the motor shaft; 0: released */
};

/* State of one drive. */
struct sim_drive {
    double i_alpha;     /* A */
    double i_beta;      /* A */
    double w_m;         /* rad/s, of the rotor */
    double theta_e;     /* rad, electrical */
    double v_d;         /* V, integrators of the current control */
    double v_q;         /* V */
    double u_alpha;     /* V, of the next period */
    double u_beta;      /* V */
    double integral_nm; /* integrator of the speed control or of the slip limiter */
    double limiter;     /* 0 to 1, of the torque limiter */
};

/* The train; the first fields are constants. */
struct sim_train {
    double dt_s;            /* control period: voltages are constant over it */
    double u_dc;            /* V, of the dc link without load */
    double radius_m;        /* of the wheel over the gear's ratio */
    double weight_nm;       /* wheel load times radius: the torque at traction coefficient 1 */
    double inertia;         /* kg m2, of the train per drive at the rotor */
    double speed_floor_m_s; /* creep is sliding speed over train speed, and this at least */
    double cut_per_s;       /* how fast the torque limiter falls */
    double restore_per_s;   /* and returns */
    int64_t steps;          /* of Runge and Kutta in a period */
    int64_t on_rail;        /* 1: wheels roll on a rail; 0: the load is given */
    double w_m;             /* rad/s, of a rotor with a nominal wheel that does not slide */
    double integral_nm;     /* integrator of the driver */
    double demand_nm;       /* torque demand on each drive */
};

/* Creep force curve of a rail (sim/physics/adhesion.py). */
struct sim_rail {
    double mu_0; /* friction at standstill */
    double A;    /* ratio at infinite sliding speed */
    double B;    /* s/m, decay */
    double k_A;  /* reduction factor in the area of adhesion */
    double k_S;  /* and of slip */
    double k_c;  /* contact stiffness per wheel load */
};

/* What loads one wheel during a period. */
struct sim_contact {
    struct sim_rail rail;
    double load_nm;         /* the given load, unless on a rail */
    double v_m_s;           /* of the train */
    double radius_m;        /* of this wheel over the gear's ratio */
    double weight_nm;       /* its load times radius */
    double limit_nm;        /* most torque that an adhesion loss leaves */
    double speed_floor_m_s; /* as in `struct sim_train` */
    int64_t on_rail;        /* likewise */
};

/* What happens in each of n periods. */
struct sim_schedule {
    int64_t periods;             /* n */
    int64_t drives;              /* N */
    const double *w_ref;         /* (n) rotor speed wanted, rad/s */
    const double *w_acc;         /* (n) its slope, rad/s2 */
    const double *load_nm;       /* (n) healthy load per drive; on a rail: running resistance */
    const double *carry;         /* (n, N) share of what is asked that the rail can carry; 1: all */
    const uint8_t *cut;          /* (n, N) 1: the torque limiter is commanded down */
    const struct sim_rail *rail; /* (n, N) */
};

/* A whole record of temperatures: L steps of M motors (gateway/study/thermal_dataset.py). */
struct sim_heat_record {
    int64_t steps;           /* L */
    int64_t motors;          /* M */
    int64_t samples;         /* K */
    double dt_s;             /* of a step; well below the shortest time constant, 200 s */
    double bearing_air;      /* W/K, of bearings to the air */
    double rotor_share;      /* of the iron loss */
    double copper_slope;     /* 1/K, of the copper loss */
    double copper_reference; /* degC, where the copper loss is what is given */
    const double *copper;    /* (L, M) W at the reference temperature */
    const double *iron;      /* (L) W */
    const double *friction;  /* (L, M) W per bearing */
    const double *cooling;   /* (L, M) W/K */
    const double *air_c;     /* (L, M) degC */
    const double *fault_w;   /* (L) W, in `fault_node` of `fault_motor` */
    int64_t fault_motor;     /* index, or -1 */
    int64_t fault_node;      /* index, or -1 */
    const double *links;     /* (SIM_NODES, SIM_NODES) W/K */
    const double *capacity;  /* (SIM_NODES) J/K */
    const int64_t *at;       /* (K) ascending: steps after which the state is kept */
};

#endif
