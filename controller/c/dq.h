/* Amplitude and frequency controller of a resonant actuator: types and functions.
 *
 * The plate is driven with v = V sin(p) near its resonance; Wd and Wq are its response in phase and in quadrature. Every
 * sample_time dq_step takes Wd and Wq and says with which V and at which frequency to drive on; dq_demodulate makes Wd and Wq
 * of the sensor's samples. All that is peculiar to one plate is in dq_params, which identify writes into a header of its own;
 * so one program may drive several plates, each with its own dq_state.
 *
 *     static dq_state loop;
 *     static dq_demodulator sensor;
 *     dq_params params = DQ_PLATE_PARAMS;                   from the plate's header, or from flash
 *     if (dq_init(&loop, &params) != DQ_PARAMS_OK) ...      it then stays in DQ_FAULT_PARAMETERS
 *     dq_demodulator_init(&sensor, &params);
 *     each sample of the sensor:  response = dq_demodulate(&sensor, sample, phase);
 *     each step:  in.wd = response.wd; in.wq = response.wq; in.clipped = response.clipped;
 *                              in.samples = response.samples;  out = dq_step(&loop, &in);
 *
 * No heap, no recursion, no library function, and no loop but over at most DQ_DELAY_MAX numbers. Not reentrant for one dq_state.
 */
#ifndef DQ_H
#define DQ_H

#include <stdint.h>

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__ > 0)
#error "compile without -ffast-math and -ffinite-math-only: they remove the tests for readings that are missing (not finite)"
#endif

#ifdef __cplusplus
extern "C" {
#endif

#ifndef DQ_DOUBLE
#define DQ_DOUBLE 0 /* 1: double precision, everywhere */
#endif
#if DQ_DOUBLE
typedef double dq_real;
#else
typedef float dq_real;
#endif
#define DQ_LAYOUT 4u   /* of dq_params: what was saved to flash by another layout is refused */
#define DQ_DELAY_MAX 8 /* samples that a command may be on its way, at most */

/* --- What is asked for, and what is said ------------------------------------------------------------------------------ */

typedef enum {
    DQ_TASK_REGULATE = 0,  /* find the resonance, start softly, hold the amplitude, track the resonance */
    DQ_TASK_AMPLITUDE = 1, /* the same at the frequency f0 + offset, without tracker */
    DQ_TASK_OPEN_LOOP = 2, /* the voltage and the frequency f0 + offset that are stated */
    DQ_TASK_SWEEP = 3      /* the stated voltage, from f0 + offset to f0 - offset */
} dq_task;

typedef enum {
    DQ_MODE_OFF = 0,
    DQ_MODE_FIND = 1,       /* a tenth of the amplitude, until the tracker has found the resonance */
    DQ_MODE_SOFT_START = 2, /* the amplitude rises */
    DQ_MODE_LOCK = 3,       /* until amplitude, phase and voltage are what the identified plate says */
    DQ_MODE_RUN = 4,
    DQ_MODE_FAULT = 5,      /* no voltage; latched until a reset with enable low */
    DQ_MODE_OPEN_LOOP = 6,
    DQ_MODE_SWEEP = 7
} dq_mode;

typedef enum {
    DQ_FAULT_NONE = 0,
    DQ_FAULT_MISSING = 1,     /* no finite reading, or none that a plate can have come to; too few samples, or steps */
    DQ_FAULT_DEAD = 2,        /* the sensor shows next to nothing of what is driven */
    DQ_FAULT_STUCK = 3,       /* the same reading to the last bit, though the drive has moved */
    DQ_FAULT_ABOVE = 4,       /* an amplitude well above what is asked for */
    DQ_FAULT_EDGE = 5,        /* the frequency is at the end of its window */
    DQ_FAULT_REVERSED = 6,    /* Wq answers the frequency the wrong way round */
    DQ_FAULT_LOST = 7,        /* the resonance was not found, or the loop did not lock, in time */
    DQ_FAULT_CLIPPED = 8,     /* the converter of the sensor is at its end */
    DQ_FAULT_FOLLOW = 9,      /* in run the amplitude is not the one that is asked for */
    DQ_FAULT_MODEL = 10,      /* the voltage is not the one that the identified plate needs for it */
    DQ_FAULT_OSCILLATES = 11, /* the voltage swings to and fro */
    DQ_FAULT_PARAMETERS = 12  /* dq_init was given parameters that cannot be */
} dq_fault;

typedef enum {
    DQ_PARAMS_OK = 0,
    DQ_PARAMS_LAYOUT = 1,
    DQ_PARAMS_PLATE = 2,
    DQ_PARAMS_LIMITS = 3,
    DQ_PARAMS_AMPLITUDE_LOOP = 4,
    DQ_PARAMS_TRACKER = 5,
    DQ_PARAMS_OBSERVER = 6,
    DQ_PARAMS_GUARD = 7,
    DQ_PARAMS_START = 8,
    DQ_PARAMS_DEMODULATOR = 9
} dq_check;

typedef enum { DQ_LAW_PI = 0, DQ_LAW_ADAPTIVE = 1 } dq_law;
typedef enum { DQ_TRACKER_NONE = 0, DQ_TRACKER_SHARE = 1, DQ_TRACKER_SIGN = 2, DQ_TRACKER_PLL = 3 } dq_tracker;
typedef enum { DQ_SOURCE_ANY = 0, DQ_SOURCE_STEPS = 1, DQ_SOURCE_TIMER = 2 } dq_source;

/* --- Parameters: a plain struct, to be copied, changed, checked by dq_set and saved to flash as it is ------------------- */

typedef struct {
    uint32_t layout; /* DQ_LAYOUT */

    /* The identified plate, and the loop's sensor: its readings are multiplied by sensor_d + j sensor_q. */
    dq_real gain; /* response per drive at resonance */
    dq_real f0;   /* Hz */
    dq_real sensor_d;
    dq_real sensor_q;

    /* Limits. */
    dq_real amplitude;           /* the most that may be asked for */
    dq_real voltage_lowest;      /* peak; negative: turned by half a period, which brakes */
    dq_real voltage_highest;
    dq_real voltage_slew;        /* from one step to the next */
    dq_real frequency_lowest;    /* Hz */
    dq_real frequency_highest;
    dq_real tracker_lowest; /* Hz: within these, by what the source's steps need */
    dq_real tracker_highest;
    dq_real temperature_lowest;  /* degC: what is beyond is taken for the end */
    dq_real temperature_highest;

    /* Amplitude loop: V = clip(U + kp e + I), I += ki e + (V - wanted) ki / kp, e = M - Wd. */
    int32_t law; /* dq_law */
    dq_real kp;
    dq_real ki;
    /* Its feed-forward: U brings the model M to the reference, M <- keep M + push U; seen delay samples later. */
    int32_t model_delay; /* samples from U to Wd, whole; -1: no feed-forward */
    dq_real model_keep;
    dq_real model_push;
    dq_real model_latest; /* share of the younger of two samples: for a fraction of a sample */

    /* Tracker: each `every` steps the estimate of the resonance moves by what Wq/Wd says. */
    int32_t tracker; /* dq_tracker */
    int32_t every;
    dq_real tracker_gain;           /* Hz: of Wq/Wd; of DQ_TRACKER_SIGN: the step */
    dq_real tracker_share;          /* of what a source with steps leaves */
    dq_real tracker_lead;           /* Hz: of a change of Wq/Wd (DQ_TRACKER_PLL) */
    dq_real tracker_half_bandwidth; /* Hz */
    dq_real tracker_max_step;       /* Hz */
    dq_real tracker_most;           /* Wq/Wd beyond which it counts as that */
    dq_real gate;                   /* |W| over what is asked for, from which Wq/Wd is believed */
    dq_real k_T;                    /* Hz/degC; 0: no thermometer */
    dq_real temperature;            /* degC at which f0 is the resonance */
    int32_t source;                 /* dq_source: of the frequency */
    dq_real source_step;            /* Hz */
    dq_real source_first;           /* Hz, of one of its frequencies less f0 */
    dq_real source_periods;         /* ticks of the timer in a period */
    dq_real source_centre;          /* Hz, of these */
    dq_real dead_band;              /* Hz */

    /* Observer of DQ_LAW_ADAPTIVE. */
    dq_real K;       /* share of the error that a step removes */
    dq_real push;    /* G T/tau */
    dq_real damping; /* T/tau */
    dq_real turn;    /* 2 pi T */
    dq_real keep_d;  /* pole along d, which shows the damping, and along q, which shows the resonance */
    dq_real keep_q;
    dq_real sweep_most;   /* Hz that the frequency moves in a step at most */
    int32_t sent;         /* samples that a command is on its way */
    int32_t late;         /* samples by which a reading is late, whole, and the rest of one */
    dq_real between;

    /* Guard: how long, in steps, and what for. */
    int32_t patience;     /* missing, dead, above, edge, clipped */
    dq_real samples;      /* missing: of the sensor, in a step; 0: not looked at */
    int32_t repeats;      /* stuck */
    int32_t doubts;       /* reversed */
    int32_t follows;      /* follow, model */
    int32_t swings;       /* oscillates: turns of the voltage, none more than `swing_time` after the one before */
    int32_t swing_time;
    dq_real swing;        /* of the voltage's limit, about its mean */
    dq_real ceiling;      /* above: of what is asked for */
    dq_real ceiling_least; /* but no less than this amplitude */
    dq_real dead_share;   /* dead: of what is driven */
    dq_real dead_least;   /* only where that is above this amplitude: a few units of the converter */
    dq_real guard_gain;   /* gain under the heaviest finger of the design */
    dq_real guard_decay;  /* 1 - exp(-T/tau) */
    dq_real guard_edge;   /* Hz */
    dq_real guard_turn;   /* 2 pi tau guard_decay */
    dq_real guard_memory; /* weight of the latest in a mean */
    dq_real jump;         /* from reading to reading: more than this, and than `jumps` of the last |W|, no plate moves in a step */
    dq_real jumps;

    /* Start. */
    dq_real find;      /* amplitude to begin with */
    dq_real ramp;      /* its rise in a step */
    dq_real headroom;  /* voltage until it runs, over what the plate was seen to need for what is asked */
    dq_real heaviest;  /* what the design's heaviest finger makes it need, over the untouched plate: no more is believed */
    int32_t settled;   /* steps for which it has to be near before it goes on */
    int32_t lost;      /* steps after which it is lost */
    dq_real memory;    /* weight of the latest reading in the means that decide */
    dq_real beside_find; /* |Wq|/Wd to leave find, to leave lock, and to stay in run */
    dq_real beside_lock;
    dq_real beside_run;
    dq_real voltage_least; /* voltage in lock over that which the untouched plate needs, from and to */
    dq_real voltage_most;
    dq_real voltage_run; /* and in run, to: a heavy finger */
    dq_real sweep;     /* Hz per step of DQ_TASK_SWEEP */

    /* Demodulator. */
    dq_real demodulator_share; /* of each of four one-pole filters */
    dq_real demodulator_scale; /* response per unit of a sample */
    dq_real sample_most;       /* |sample| from which the converter is at its end */
    int32_t sample_patience;   /* samples that may be missing in a row; those for which `clipped` is remembered */
} dq_params;

/* --- The step ----------------------------------------------------------------------------------------------------------- */

/* Whatever is not finite is held at its last good value; what is out of range is taken for the end of the range; both count. */
typedef struct {
    dq_real reference;   /* wanted amplitude, peak */
    dq_real share;       /* of the bandwidth, 0 to 1 */
    dq_real wd;          /* response as the demodulator shows it, peak; not finite: missing */
    dq_real wq;
    dq_real temperature; /* of the plate, degC; not looked at without a thermometer */
    dq_real voltage;     /* of DQ_TASK_OPEN_LOOP and DQ_TASK_SWEEP, peak */
    dq_real offset;      /* Hz above f0: of these and of DQ_TASK_AMPLITUDE; of DQ_TASK_REGULATE where the tracker begins */
    int32_t task;        /* dq_task; looked at when it is switched on */
    int32_t clipped;     /* not zero: the sensor's converter is at its end */
    uint32_t samples;    /* finite ones of the sensor so far, as dq_demodulate counts them; 0: not looked at */
    int32_t enable;      /* not zero: on */
    int32_t reset;       /* not zero, while enable is zero: ends a fault */
} dq_input;

typedef struct {
    dq_real voltage;   /* peak; negative: turned by half a carrier period */
    dq_real frequency; /* Hz */
    dq_real offset;    /* the same, Hz above f0: what is to be used where it is made of whole steps */
    int32_t fault;     /* dq_fault */
    int32_t mode;      /* dq_mode */
    uint32_t held;     /* inputs that were not finite or out of range, so far */
} dq_output;

/* What a step remembers. To be read by a debugger; only the functions below write it. */
typedef struct {
    dq_params params;
    dq_real anti_windup, per_push, per_model_push, per_half_bandwidth, window_lowest, window_highest; /* of the parameters */
    /* machine */
    int32_t mode, fault, task, near, waited, off, swung, since_swing, side;
    dq_real reference, share, told, stated_voltage, stated_offset, asked, learned, swept;
    dq_real mean_d, mean_q, mean_voltage, mean_asked, needs;
    uint32_t held;
    /* amplitude loop */
    dq_real integral, output, model[DQ_DELAY_MAX + 2];
    /* tracker */
    dq_real offset, estimate, temperature, ratio;
    int32_t count;
    /* observer */
    dq_real d, q, damping, resonance, voltages[DQ_DELAY_MAX + 1], frequencies[DQ_DELAY_MAX + 1];
    dq_real past_d[DQ_DELAY_MAX + 2], past_q[DQ_DELAY_MAX + 2]; /* the first: the prediction of this step */
    /* guard */
    int32_t missing, dead, stuck, above, edge, turned, clips;
    uint32_t samples;
    dq_real arrived, behind; /* steps: of samples since the one before; by which samples, or steps, stay away */
    dq_real expected, holds, allowed, last_d, last_q, since_voltage, since_frequency, voltage, mean_frequency, mean_seen_q, moves;
} dq_state;

/* Off, without a fault, with a copy of the parameters; whether they are as they can be: if not, it stays in a fault. */
dq_check dq_init(dq_state *s, const dq_params *p);
/* Other parameters, from the next step on; with any that cannot be it goes on with those that it has. */
dq_check dq_set(dq_state *s, const dq_params *p);
/* What is wrong with parameters, without using them. */
dq_check dq_check_params(const dq_params *p);
/* One step of the controller. */
dq_output dq_step(dq_state *s, const dq_input *in);

/* --- The demodulator ---------------------------------------------------------------------------------------------------- */

typedef struct {
    dq_real d, q;
} dq_pole;

typedef struct {
    dq_real share, scale, most;
    int32_t patience, missed, clipped;
    uint32_t samples;
    dq_pole poles[4];
} dq_demodulator;

typedef struct {
    dq_real wd;
    dq_real wq;
    int32_t clipped; /* the converter was at its end within the last sample_patience samples */
    uint32_t samples; /* finite ones so far */
} dq_response;

/* At rest. */
void dq_demodulator_init(dq_demodulator *s, const dq_params *p);
/* One sample of the sensor; not finite: missing. `phase` is the accumulator's of the drive V sin(phase) when it was taken, 2^32
 * a turn: with a timer, its count since the period began, times 2^32 over the ticks of a period. */
dq_response dq_demodulate(dq_demodulator *s, dq_real sample, uint32_t phase);
/* 0 where a settled response of 0.8 - 0.6j is demodulated to that. */
int dq_self_test(void);

/* --- What a rig takes --------------------------------------------------------------------------------------------------- */

/* Code of a converter for the peak voltage: the nearest within +-(2^(bits-1) - 1), full_scale for 2^(bits-1). */
int32_t dq_dac_code(dq_real voltage, int32_t bits, dq_real full_scale);
/* Duty ratio, x (a[0] + a[1] x^2 + ...) with x = voltage / limit. */
dq_real dq_duty(dq_real voltage, dq_real limit, const dq_real *a, int32_t terms);
/* Ticks of a timer in a carrier period, for a source of DQ_SOURCE_TIMER. */
uint32_t dq_timer_ticks(const dq_params *p, dq_real offset);
/* Increment of an accumulator of 32 bits: that of f0, which is `base` and `fraction`, and per_hz for each Hz of offset. */
uint32_t dq_dds_increment(dq_real offset, uint32_t base, dq_real fraction, dq_real per_hz);

#ifdef __cplusplus
}
#endif
#endif
