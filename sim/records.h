/* Records of the simulator: one line per field, with unit and meaning.
 *
 * Same form as gateway/core/records.h, but apart from it: no source of the core includes this
 * file, so that the truth cannot reach an estimate. */
#ifndef TRACTION_SIM_RECORDS_H
#define TRACTION_SIM_RECORDS_H

#include <stdint.h>

#define SIM_NODES 6 /* nodes of a motor's thermal network */

/* Columns of the plant's outputs for each drive. */
enum plant_output {
    OUT_I_ALPHA = 0, /* A, phase current */
    OUT_I_BETA = 1,  /* A, phase current */
    OUT_U_ALPHA = 2, /* V, mean over the last period */
    OUT_U_BETA = 3,  /* V, mean over the last period */
    OUT_U_DC = 4,    /* V, of the dc link */
    OUT_TORQUE = 5,  /* Nm, of the air gap */
    OUT_SPEED = 6,   /* rad/s, of the rotor */
    OUT_ANGLE = 7,   /* rad, electrical, 0 to 2 pi */
    OUT_LOAD = 8,    /* Nm, load at the rotor */
    OUT_COMMAND = 9, /* Nm, torque command as the drive reports it */
    OUT_COLUMNS = 10,
};

/* Constants of one drive; the first seven are those of the motor. */
struct sim_motor {
    double R_s;            /* ohm, stator resistance */
    double L_s;            /* H, stator inductance */
    double psi_pm;         /* Wb, flux of the magnets */
    double pole_pairs;     /* 1 */
    double J;              /* kg m2, inertia of everything that turns with the rotor */
    double B;              /* Nm s/rad, friction */
    double k_p;            /* 1, Park constant: T = k_p pole_pairs psi_pm i_q */
    double T_max;          /* Nm, largest torque */
    double cut_level;      /* 0 to 1, lowest level of the torque limiter */
    double share;          /* share of the train's demand that this drive delivers */
    double wheel;          /* wheel diameter over the nominal one */
    double phase_a_open;   /* 1: phase a is open; 0: it is not */
    double psi_pm_control; /* Wb, flux of the magnets that the drive's own control uses */
    double effort_nm;      /* Nm, largest demand of the driver; that of the first drive counts */
    double creep_max;      /* creep that the slip limiter allows; infinite: no limiter */
    double slip_bandwidth; /* rad/s, bandwidth of the slip limiter */
    double slip_rate;      /* 1/s, rate of the slip limiter's integrator */
    double brake_nm;       /* Nm, torque of the friction brake at the motor shaft; 0: released */
};

/* State of one drive. */
struct sim_drive {
    double i_alpha;     /* A, current */
    double i_beta;      /* A, current */
    double w_m;         /* rad/s, speed of the rotor */
    double theta_e;     /* rad, electrical angle of the rotor */
    double v_d;         /* V, integrator of the current control, d axis */
    double v_q;         /* V, integrator of the current control, q axis */
    double u_alpha;     /* V, voltage of the next period */
    double u_beta;      /* V, voltage of the next period */
    double integral_nm; /* Nm, integrator of the speed control or of the slip limiter */
    double limiter;     /* 0 to 1, level of the torque limiter */
};

/* The train; the first fields are constants. */
struct sim_train {
    double dt_s;            /* s, control period: voltages are constant over it */
    double u_dc;            /* V, dc link voltage without load */
    double radius_m;        /* m, wheel radius over the gear ratio */
    double weight_nm;       /* Nm, wheel load times radius: the torque at traction coefficient 1 */
    double inertia;         /* kg m2, of the train, per drive and referred to the rotor */
    double speed_floor_m_s; /* m/s, least train speed by which a sliding speed is divided: creep */
    double cut_per_s;       /* 1/s, rate at which the torque limiter falls */
    double restore_per_s;   /* 1/s, rate at which it returns */
    int64_t steps;          /* Runge-Kutta steps in a period */
    int64_t on_rail;        /* 1: wheels roll on a rail; 0: the load is given */
    double w_m;             /* rad/s, speed of a rotor with a nominal wheel that does not slide */
    double integral_nm;     /* Nm, integrator of the driver */
    double demand_nm;       /* Nm, torque demand on each drive */
};

/* Creep force curve of a rail (sim/physics/adhesion.py). */
struct sim_rail {
    double mu_0; /* coefficient of friction at standstill */
    double A;    /* friction at infinite sliding speed over that at standstill */
    double B;    /* s/m, decay of the friction with the sliding speed */
    double k_A;  /* reduction factor in the area of adhesion */
    double k_S;  /* reduction factor in the area of slip */
    double k_c;  /* contact stiffness per wheel load */
};

/* Load of one wheel during a period. */
struct sim_contact {
    struct sim_rail rail;   /* what the wheel runs on */
    double load_nm;         /* Nm, the given load; not used on a rail */
    double v_m_s;           /* m/s, speed of the train */
    double radius_m;        /* m, radius of this wheel over the gear ratio */
    double weight_nm;       /* Nm, load of this wheel times radius */
    double limit_nm;        /* Nm, largest torque that an adhesion loss leaves */
    double speed_floor_m_s; /* m/s, as in `struct sim_train` */
    int64_t on_rail;        /* as in `struct sim_train` */
};

/* Events of each of n periods. */
struct sim_schedule {
    int64_t periods;       /* n */
    int64_t drives;        /* N */
    const double *w_ref;   /* (n) rad/s, speed reference of the rotor */
    const double *w_acc;   /* (n) rad/s2, slope of the speed reference */
    const double *load_nm; /* (n) Nm, healthy load per drive; on a rail: running resistance */
    const double *carry;   /* (n, N) share of the requested torque that the rail carries; 1: all */
    const uint8_t *cut;    /* (n, N) 1: the torque limiter is commanded down */
    const struct sim_rail *rail; /* (n, N) creep force curves */
};

/* A whole record of temperatures: L steps of M motors (gateway/study/thermal_dataset.py). */
struct sim_heat_record {
    int64_t steps;       /* L, number of steps */
    int64_t motors;      /* M, number of motors */
    int64_t samples;     /* K, number of samples that are kept */
    double dt_s;         /* s, duration of a step, well below the shortest time constant, 200 s */
    double bearing_air;  /* W/K, each bearing to the air */
    double rotor_share;  /* share of the iron loss in the rotor */
    double copper_slope; /* 1/K, relative increase of the copper loss with temperature */
    double copper_reference; /* degC, temperature of the winding that `copper` refers to */
    const double *copper;    /* (L, M) W, copper loss at the reference temperature */
    const double *iron;      /* (L) W, iron loss */
    const double *friction;  /* (L, M) W, friction in each bearing */
    const double *cooling;   /* (L, M) W/K, frame to the air */
    const double *air_c;     /* (L, M) degC, air */
    const double *fault_w;   /* (L) W, additional heat in `fault_node` of `fault_motor` */
    int64_t fault_motor;     /* index of the motor, or -1: no fault */
    int64_t fault_node;      /* index of the node, or -1: no fault */
    const double *links;     /* (SIM_NODES, SIM_NODES) W/K, between the nodes */
    const double *capacity;  /* (SIM_NODES) J/K, heat capacities */
    const int64_t *at;       /* (K) ascending: steps after which the temperatures are kept */
};

#endif
