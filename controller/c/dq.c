/* The law in dq.h: machine, amplitude loop, tracker, observer and guard of one step, and the demodulator.
 *
 * The same operations, in the same order, are in the Python package `controller`, which simulates, promises and tests them; both
 * give the same bits where nothing is contracted (gcc: -ffp-contract=off). Comparisons are written so that a NaN fails them.
 */
#include "dq.h"

#include <float.h>
#include <math.h> /* for NAN alone */
#include <string.h> /* for memset alone */

#define C(x) ((dq_real)(x)) /* a constant, rounded once */
#if DQ_DOUBLE
#define LARGEST DBL_MAX
#define WHOLE C(4503599627370496.0) /* 2^52: from there on all numbers are whole */
#else
#define LARGEST FLT_MAX
#define WHOLE C(8388608.0) /* 2^23 */
#endif
#define ALIKE_LEAST C(0.3333333333333333) /* of its answer to the frequency, between which Wq counts as that, turned round */
#define ALIKE_MOST C(3.0)
#define ANSWER C(0.1) /* of what the drive makes of the plate, above which an answer stands out from the noise */
#define ROUGH C(0.5)  /* of the amplitude that is asked, by which it may be off to leave find, and lock and run */
#define NEAR C(0.1)

/* What a step drives with. */
typedef struct {
    dq_real voltage;
    dq_real frequency; /* Hz */
} command;

/* The reading of a step. */
typedef struct {
    dq_real d, q;
    int there;
} reading;

/* What the machine asks of law and guard in a step. */
typedef struct {
    dq_real reference, share;
    dq_real least;           /* amplitude that the tracker counts as asked for, at least */
    dq_real lowest, highest; /* of the voltage */
    int frozen;              /* no tracker */
    int open;                /* no law: `stated` */
    command stated;
} request;

static dq_real clip(dq_real x, dq_real low, dq_real high)
{
    x = x > high ? high : x;
    return x < low ? low : x;
}

static int finite_real(dq_real x)
{
    return x >= -LARGEST && x <= LARGEST;
}

static int same(dq_real a, dq_real b)
{
    return a <= b && a >= b;
}

static dq_real size_of(dq_real x)
{
    return x < C(0) ? -x : x;
}

/* The largest whole number that is not above x. */
static dq_real floor_of(dq_real x)
{
    dq_real cut;

    if (!(x < WHOLE && x > -WHOLE))
        return x;
    cut = (dq_real)(int64_t)x;
    return cut > x ? cut - C(1) : cut;
}

/* --- parameters --------------------------------------------------------------------------------------------------------- */

static int within(dq_real x, dq_real low, dq_real high)
{
    return x >= low && x <= high;
}

static int share(dq_real x)
{
    return within(x, C(0), C(1));
}

static int count(int32_t n)
{
    return n >= 1 && n <= 16777216; /* what a float counts to */
}

static int plate_is_sound(const dq_params *p)
{
    return finite_real(p->gain) && size_of(p->gain) > C(0) && within(p->f0, C(0), LARGEST) && finite_real(p->sensor_d)
        && finite_real(p->sensor_q);
}

static int limits_are_sound(const dq_params *p)
{
    return p->amplitude > C(0) && finite_real(p->amplitude) && within(p->voltage_lowest, -p->voltage_highest, C(0))
        && p->voltage_highest > C(0) && finite_real(p->voltage_highest) && p->voltage_slew > C(0)
        && within(p->f0, p->tracker_lowest, p->tracker_highest) && p->tracker_lowest >= p->frequency_lowest
        && p->tracker_highest <= p->frequency_highest
        && within(p->temperature, p->temperature_lowest, p->temperature_highest);
}

static int amplitude_loop_is_sound(const dq_params *p)
{
    return p->kp * p->gain > C(0) && within(p->ki / p->kp, C(0), C(1)) && p->model_delay >= -1 && p->model_delay <= DQ_DELAY_MAX
        && share(p->model_keep) && share(p->model_latest) && (p->model_delay < 0 || p->model_push * p->gain > C(0));
}

static int tracker_is_sound(const dq_params *p)
{
    const dq_real most = p->frequency_highest - p->frequency_lowest; /* may be without limit */

    return p->tracker >= DQ_TRACKER_NONE && p->tracker <= DQ_TRACKER_PLL && count(p->every)
        && within(p->tracker_gain, C(0), LARGEST) && share(p->tracker_share) && within(p->tracker_lead, C(0), LARGEST)
        && p->tracker_half_bandwidth > C(0) && within(p->tracker_max_step, C(0), most) && within(p->tracker_most, C(0), LARGEST)
        && within(p->gate, C(0), C(10)) && finite_real(p->k_T) && p->source >= DQ_SOURCE_ANY && p->source <= DQ_SOURCE_TIMER
        && (p->source == DQ_SOURCE_ANY || p->source_step > C(0)) && finite_real(p->source_first)
        && (p->source != DQ_SOURCE_TIMER || (p->source_periods >= C(1) && p->source_centre > C(0)))
        && within(p->dead_band, C(0), LARGEST);
}

static int observer_is_sound(const dq_params *p)
{
    return p->law == DQ_LAW_PI
        || (p->law == DQ_LAW_ADAPTIVE && p->K > C(0) && p->K < C(2) && p->push * p->gain > C(0)
            && within(p->damping, C(1e-9), C(1)) && p->turn > C(0) && share(p->keep_d) && share(p->keep_q)
            && p->sweep_most > C(0) && p->sent >= 0 && p->sent <= DQ_DELAY_MAX && p->late >= 0 && p->late <= DQ_DELAY_MAX && share(p->between));
}

static int guard_is_sound(const dq_params *p)
{
    return count(p->patience) && within(p->samples, C(0), LARGEST) && count(p->repeats) && count(p->doubts) && count(p->follows) && count(p->swings)
        && count(p->swing_time) && within(p->swing, C(0.01), C(2)) && within(p->ceiling, C(1), C(10))
        && within(p->ceiling_least, C(0), LARGEST) && share(p->dead_share) && within(p->dead_least, C(0), LARGEST)
        && p->guard_gain > C(0) && share(p->guard_decay) && within(p->guard_edge, C(0), LARGEST) && finite_real(p->guard_turn)
        && share(p->guard_memory) && p->jump > C(0) && within(p->jumps, C(0), LARGEST);
}

static int start_is_sound(const dq_params *p)
{
    return p->find > C(0) && p->find <= p->amplitude && p->ramp > C(0) && within(p->headroom, C(1), C(1000))
        && within(p->heaviest, C(1), C(1000)) && count(p->settled) && count(p->lost) && share(p->memory) && p->beside_find > C(0)
        && p->beside_lock > C(0) && p->beside_run > C(0) && within(p->voltage_least, C(0), C(1)) && p->voltage_most >= C(1)
        && p->voltage_run >= p->voltage_most && p->sweep > C(0);
}

static int demodulator_is_sound(const dq_params *p)
{
    return share(p->demodulator_share) && p->demodulator_scale > C(0) && p->sample_most > C(0) && count(p->sample_patience);
}

dq_check dq_check_params(const dq_params *p)
{
    if (p->layout != DQ_LAYOUT)
        return DQ_PARAMS_LAYOUT;
    if (!plate_is_sound(p))
        return DQ_PARAMS_PLATE;
    if (!limits_are_sound(p))
        return DQ_PARAMS_LIMITS;
    if (!amplitude_loop_is_sound(p))
        return DQ_PARAMS_AMPLITUDE_LOOP;
    if (!tracker_is_sound(p))
        return DQ_PARAMS_TRACKER;
    if (!observer_is_sound(p))
        return DQ_PARAMS_OBSERVER;
    if (!guard_is_sound(p))
        return DQ_PARAMS_GUARD;
    if (!start_is_sound(p))
        return DQ_PARAMS_START;
    return demodulator_is_sound(p) ? DQ_PARAMS_OK : DQ_PARAMS_DEMODULATOR;
}

dq_check dq_set(dq_state *s, const dq_params *p)
{
    const dq_check found = dq_check_params(p);

    if (found != DQ_PARAMS_OK)
        return found;
    s->params = *p;
    s->anti_windup = p->ki / p->kp;
    s->per_push = C(1) / p->push;
    s->per_model_push = C(1) / p->model_push;
    s->per_half_bandwidth = C(1) / p->tracker_half_bandwidth;
    s->window_lowest = p->tracker_lowest - p->f0;
    s->window_highest = p->tracker_highest - p->f0;
    return DQ_PARAMS_OK;
}

/* --- the source of the frequency ---------------------------------------------------------------------------------------- */

/* n, the ticks beyond source_periods of the period nearest to that of `offset`: f = centre / (1 + n / periods) as a series. */
static dq_real ticks_beyond(const dq_params *p, dq_real offset)
{
    const dq_real x = (offset - p->source_first) * (C(1) / p->source_centre);

    return floor_of(p->source_periods * (x * (x * (C(1) - x) - C(1))) + C(0.5));
}

/* The frequency nearest to `offset` that the source can make. */
static dq_real made(const dq_params *p, dq_real offset)
{
    if (p->source == DQ_SOURCE_STEPS)
        return p->source_first + p->source_step * floor_of((offset - p->source_first) * (C(1) / p->source_step) + C(0.5));
    if (p->source == DQ_SOURCE_TIMER) {
        const dq_real y = ticks_beyond(p, offset) * (C(1) / p->source_periods);

        return p->source_first + p->source_centre * (y * (y * (C(1) - y) - C(1)));
    }
    return offset;
}

/* --- the amplitude loop ------------------------------------------------------------------------------------------------- */

static dq_real amplitude_loop(dq_state *s, const request *asked, reading W)
{
    const dq_params *p = &s->params;
    const int leads = p->model_delay >= 0;
    dq_real aim = asked->reference, held = s->integral, next = C(0);
    dq_real error, wanted, output;
    int k;

    if (!W.there)
        return s->output;
    if (leads) {
        const dq_real now = s->model[0];
        const dq_real part = asked->share < C(1) ? asked->share * (p->kp * p->model_push) : C(1);
        const dq_real enough = (part * (asked->reference - now) + (C(1) - p->model_keep) * now) * s->per_model_push;
        const dq_real ahead = clip(enough, asked->lowest, asked->highest);
        const int32_t late = p->model_delay;

        aim = p->model_latest * s->model[late] + (C(1) - p->model_latest) * s->model[late + 1];
        held = s->integral + ahead;
        next = p->model_keep * now + p->model_push * ahead;
    }
    error = asked->share * (aim - W.d);
    wanted = p->kp * error + held;
    output = clip(clip(wanted, s->output - p->voltage_slew, s->output + p->voltage_slew), asked->lowest, asked->highest);
    s->integral = s->integral + p->ki * error + (output - wanted) * s->anti_windup;
    s->output = output;
    for (k = p->model_delay + 1; leads && k > 0; k--)
        s->model[k] = s->model[k - 1];
    s->model[0] = next;
    return output;
}

/* --- the tracker -------------------------------------------------------------------------------------------------------- */

/* The step in Hz that Wq/Wd asks for. */
static dq_real wanted_step(dq_state *s, reading W, int moves)
{
    const dq_params *p = &s->params;
    dq_real ratio, before, left;

    if (p->tracker == DQ_TRACKER_SIGN)
        return W.q > C(0) ? p->tracker_gain : W.q < C(0) ? -p->tracker_gain : C(0);
    ratio = clip(W.q / (moves ? W.d : C(1)), -p->tracker_most, p->tracker_most);
    if (p->tracker == DQ_TRACKER_SHARE)
        return p->tracker_gain * ratio + p->tracker_share * (s->offset - s->estimate);
    before = s->ratio;
    s->ratio = moves ? ratio : before;
    left = s->ratio + (s->offset - s->estimate) * s->per_half_bandwidth;
    return p->tracker_lead * (s->ratio - before) + p->tracker_gain * left;
}

/* |W| from which it tells the plate from noise. */
static dq_real gate_of(const dq_params *p, const request *asked)
{
    return p->gate * (asked->reference > asked->least ? asked->reference : asked->least);
}

/* The frequency, above f0. `braked`: the voltage that made W was against it, so that Wq has the other sign. */
static dq_real track(dq_state *s, const request *asked, reading W, dq_real temperature, int braked)
{
    const dq_params *p = &s->params;
    const dq_real threshold = gate_of(p, asked);
    const int due = ++s->count >= p->every;
    const int vibrates = asked->reference > C(0) && W.d > C(0) && W.d * W.d + W.q * W.q > threshold * threshold;
    const int moves = due && W.there && vibrates && !braked;
    dq_real step = C(0), estimate, off, enough;

    if (due)
        s->count = 0;
    if (moves) {
        step = wanted_step(s, W, moves);
        if (p->tracker != DQ_TRACKER_SIGN)
            step = clip(step, -p->tracker_max_step, p->tracker_max_step);
    }
    estimate = s->estimate + p->k_T * (temperature - s->temperature);
    s->temperature = temperature;
    s->estimate = clip(estimate + step, s->window_lowest, s->window_highest);
    if (p->source == DQ_SOURCE_ANY) {
        s->offset = s->estimate;
        return s->offset;
    }
    off = s->estimate - s->offset;
    enough = C(0.5) * p->source_step + p->dead_band;
    if (off > enough || off < -enough)
        s->offset = made(p, s->estimate);
    return s->offset;
}

/* --- the observer of the pole ------------------------------------------------------------------------------------------- */

/* Z one step later: Z + (a Z + b T V)(1 + a/2 + a^2/6), a = lambda T. */
static void predict(const dq_params *p, dq_real Z[2], dq_real damping, dq_real offset, dq_real voltage)
{
    const dq_real d = Z[0], q = Z[1], x = -damping, y = p->turn * offset;
    const dq_real go_d = x * d - y * q + p->push * voltage, go_q = x * q + y * d;
    const dq_real m_d = C(1) + C(0.5) * x + (x * x - y * y) * C(0.16666666666666666);
    const dq_real m_q = C(0.5) * y + x * y * C(0.3333333333333333);

    Z[0] = d + m_d * go_d - m_q * go_q;
    Z[1] = q + m_d * go_q + m_q * go_d;
}

/* Z, T/tau and resonance with this step's news. */
static void observe(dq_state *s, const request *asked, reading W, dq_real Z[2])
{
    const dq_params *p = &s->params;
    const dq_real threshold = gate_of(p, asked);
    const dq_real *seen_d = &s->past_d[p->late], *seen_q = &s->past_q[p->late];
    dq_real e_d = C(0), e_q = C(0), size, rate;
    int learns;

    s->past_d[0] = s->d;
    s->past_q[0] = s->q;
    if (W.there) {
        e_d = W.d - (seen_d[0] + p->between * (seen_d[1] - seen_d[0]));
        e_q = W.q - (seen_q[0] + p->between * (seen_q[1] - seen_q[0]));
    }
    Z[0] = s->d + (C(1) - p->keep_d * p->keep_d) * e_d;
    Z[1] = s->q + (C(1) - p->keep_q * p->keep_q) * e_q;
    size = Z[0] * Z[0] + Z[1] * Z[1];
    learns = W.there && asked->reference > C(0) && size > threshold * threshold;
    rate = (learns ? C(1) : C(0)) / (learns ? size : C(1));
    s->damping = s->damping - (C(1) - p->keep_d) * (C(1) - p->keep_d) * rate * (e_d * Z[0] + e_q * Z[1]);
    s->damping = clip(s->damping, C(0.2) * p->damping, C(20.0) * p->damping);
    s->resonance = s->resonance + (C(1) - p->keep_q) * (C(1) - p->keep_q) * (C(1) / p->turn) * rate * (e_q * Z[0] - e_d * Z[1]);
}

/* The frequency to drive with, above f0: the resonance, by steps that the source can make. */
static dq_real followed(const dq_state *s, int frozen)
{
    const dq_params *p = &s->params;
    const dq_real last = s->frequencies[0];
    const dq_real wanted = clip(s->resonance, last - p->sweep_most, last + p->sweep_most);
    dq_real off, enough;

    if (frozen)
        return last;
    if (p->source == DQ_SOURCE_ANY)
        return wanted;
    off = s->resonance - last;
    enough = C(0.5) * p->source_step + p->dead_band;
    return off * off > enough * enough ? made(p, wanted) : last;
}

static command adaptive_law(dq_state *s, const request *asked, reading W, dq_real temperature)
{
    const dq_params *p = &s->params;
    const dq_real last = s->voltages[0];
    dq_real Z[2], after[2], held, wanted, voltage, frequency, detuned;
    command said;
    int32_t k;

    observe(s, asked, W, Z);
    s->resonance = s->resonance + p->k_T * (temperature - s->temperature);
    s->temperature = temperature;
    s->resonance = clip(s->resonance, s->window_lowest, s->window_highest);
    frequency = followed(s, asked->frozen);
    for (k = p->late + 1; k > 1; k--) {
        s->past_d[k] = s->past_d[k - 1];
        s->past_q[k] = s->past_q[k - 1];
    }
    s->past_d[1] = after[0] = Z[0];
    s->past_q[1] = after[1] = Z[1];
    for (k = p->sent; k > 0; k--) { /* what is on its way, the oldest first */
        predict(p, Z, s->damping, s->resonance - s->frequencies[k - 1], s->voltages[k - 1]);
        if (k == p->sent) {
            after[0] = Z[0];
            after[1] = Z[1];
        }
    }
    detuned = p->turn * (s->resonance - frequency);
    held = s->damping * Z[0] + detuned * Z[1]; /* -Re(lambda T Z) */
    wanted = (asked->share * (p->K / (C(1) - C(0.5) * p->damping)) * (asked->reference - Z[0]) + held) * s->per_push;
    voltage = clip(clip(wanted, last - p->voltage_slew, last + p->voltage_slew), asked->lowest, asked->highest);
    if (p->sent == 0) /* no latency: this command acts at once */
        predict(p, after, s->damping, s->resonance - frequency, voltage);
    s->d = after[0];
    s->q = after[1];
    for (k = p->sent; k > 0; k--) {
        s->voltages[k] = s->voltages[k - 1];
        s->frequencies[k] = s->frequencies[k - 1];
    }
    s->voltages[0] = voltage;
    s->frequencies[0] = frequency;
    said.voltage = voltage;
    said.frequency = p->f0 + frequency;
    return said;
}

/* --- the guard ---------------------------------------------------------------------------------------------------------- */

/* Whether the drive is another than when the reading first was the same. */
static int drive_moved(const dq_state *s, dq_real frequency)
{
    const dq_params *p = &s->params;
    const dq_real moved = s->voltage - s->since_voltage, enough = C(1e-3) * p->voltage_highest;
    const dq_real turned = frequency - s->since_frequency, far = C(2e-3) * (p->frequency_highest - p->frequency_lowest);

    return moved > enough || moved < -enough || turned > far || turned < -far;
}

/* Whether a reading is there, and one that the plate can have come to since the last; steps may not have come. */
static int believed(const dq_state *s, reading W)
{
    const dq_params *p = &s->params;
    const dq_real step = p->jump + p->jumps * (size_of(s->last_d) + size_of(s->last_q));
    const dq_real most = step * (s->arrived > C(1) ? s->arrived : C(1));
    const dq_real d = W.d - s->last_d, q = W.q - s->last_q;

    return W.there && !(d > most || d < -most || q > most || q < -most);
}

static void suspect_reading(dq_state *s, reading W, int there, dq_real frequency, int clipped)
{
    const dq_params *p = &s->params;
    const dq_real size = W.d * W.d + W.q * W.q;
    const dq_real makes = p->guard_gain * size_of(s->voltage);
    const dq_real low = p->dead_share * (makes < s->expected ? makes : s->expected), high = s->allowed;
    const int repeated = W.there && same(W.d, s->last_d) && same(W.q, s->last_q);

    s->missing = there ? 0 : s->missing + 1;
    if (W.there) {
        s->dead = size < low * low && low > p->dead_least ? s->dead + 1 : 0;
        s->above = size > high * high ? s->above + 1 : 0;
    }
    s->clips = clipped ? s->clips + 1 : 0;
    if (!repeated || s->stuck <= 0) { /* from the first repetition on: what drove the plate there is what holds it */
        s->since_voltage = s->voltage;
        s->since_frequency = frequency;
    }
    s->stuck = !repeated ? 0 : drive_moved(s, frequency) ? s->stuck + 1 : 1;
}

/* Steps that lack half of their samples, and those that did not come, less the others. */
static void suspect_samples(dq_state *s)
{
    const dq_real more = s->arrived < C(0.5) ? C(1) : s->arrived - C(2);

    s->behind = clip(s->behind + more, C(0), (dq_real)s->params.patience);
}

/* How Wq answers the frequency, and for how many steps it has done so the wrong way round. */
static void suspect_answer(dq_state *s, dq_real frequency, int frozen)
{
    const dq_params *p = &s->params;
    const dq_real off = frequency - s->mean_frequency, beside = s->last_q - s->mean_seen_q;
    const int down = s->moves < C(0);
    const dq_real answer = down ? -s->moves : s->moves, against = down ? beside : -beside;
    const int wrong = answer > ANSWER * s->expected && against > ALIKE_LEAST * answer && against < ALIKE_MOST * answer;

    s->moves = (C(1) - p->guard_decay) * s->moves - p->guard_turn * (off * s->last_d);
    s->mean_frequency = s->mean_frequency + p->guard_memory * off;
    s->mean_seen_q = s->mean_seen_q + p->guard_memory * beside;
    s->turned = wrong && !frozen ? s->turned + 1 : 0;
}

static int32_t suspected(const dq_state *s)
{
    const dq_params *p = &s->params;

    if (s->dead >= p->patience)
        return DQ_FAULT_DEAD;
    if (s->stuck >= p->repeats)
        return DQ_FAULT_STUCK;
    if (s->above >= p->patience)
        return DQ_FAULT_ABOVE;
    if (s->edge >= p->patience)
        return DQ_FAULT_EDGE;
    if (s->turned >= p->doubts)
        return DQ_FAULT_REVERSED;
    if (s->clips >= p->patience)
        return DQ_FAULT_CLIPPED;
    return s->missing >= p->patience || s->behind >= (dq_real)p->patience ? DQ_FAULT_MISSING : DQ_FAULT_NONE;
}

/* Brings the command within its limits, and says which fault there is. */
static int32_t supervise(dq_state *s, const request *asked, reading W, int there, int clipped, command *c)
{
    const dq_params *p = &s->params;
    const int tracks = p->tracker != DQ_TRACKER_NONE;
    const dq_real wanted = p->ceiling * asked->reference, faded = s->allowed - p->guard_decay * s->allowed;
    dq_real highest = wanted > p->ceiling_least ? wanted : p->ceiling_least;
    int32_t fault;

    if (!finite_real(c->frequency))
        c->frequency = p->f0;
    if (tracks) {
        const dq_real low = p->frequency_lowest + p->guard_edge, high = p->frequency_highest - p->guard_edge;

        s->edge = (c->frequency <= low || c->frequency >= high) && !asked->frozen ? s->edge + 1 : 0;
        c->frequency = clip(c->frequency, p->frequency_lowest, p->frequency_highest);
    }
    highest = faded > highest ? faded : highest;
    s->allowed = highest;
    /* The mean over a time constant holds the plate where it is; nothing, where it may be far above. */
    if (!there && !asked->open)
        c->voltage = W.there && W.d * W.d + W.q * W.q > highest * highest ? C(0) : s->holds;
    suspect_reading(s, W, there, c->frequency, clipped);
    suspect_samples(s);
    if (there) {
        s->last_d = W.d;
        s->last_q = W.q;
    }
    if (tracks)
        suspect_answer(s, c->frequency, asked->frozen);
    fault = suspected(s);
    /* Also where a reading is believed anew: the law goes on from where it was. */
    c->voltage = clip(c->voltage, s->voltage - p->voltage_slew, s->voltage + p->voltage_slew);
    c->voltage = clip(c->voltage, -asked->highest, asked->highest);
    if (fault != DQ_FAULT_NONE || !finite_real(c->voltage))
        c->voltage = C(0);
    s->expected = s->expected + p->guard_decay * (p->guard_gain * size_of(c->voltage) - s->expected);
    s->holds = s->holds + p->guard_decay * (c->voltage - s->holds);
    s->voltage = c->voltage;
    return fault;
}

/* --- the machine -------------------------------------------------------------------------------------------------------- */

/* Law and guard at rest, at the frequency from which the tracker begins. */
static void rest(dq_state *s)
{
    const dq_params *p = &s->params;
    const dq_real learned = s->task == DQ_TASK_REGULATE ? s->learned : C(0);
    const dq_real begun = clip(learned + s->stated_offset, s->window_lowest, s->window_highest);
    const dq_real first = made(p, begun);
    int k;

    s->integral = s->output = s->asked = C(0);
    for (k = 0; k < DQ_DELAY_MAX + 2; k++)
        s->model[k] = C(0);
    s->offset = first;
    s->estimate = begun;
    s->resonance = begun;
    s->swept = s->stated_offset;
    s->temperature = p->temperature;
    s->ratio = C(0);
    s->count = 0;
    s->d = s->q = C(0);
    s->damping = p->damping;
    for (k = 0; k < DQ_DELAY_MAX + 1; k++) {
        s->voltages[k] = C(0);
        s->frequencies[k] = first;
        s->past_d[k + 1] = s->past_q[k + 1] = C(0);
    }
    s->missing = s->dead = s->stuck = s->above = s->edge = s->turned = s->clips = 0;
    s->expected = s->holds = s->allowed = s->last_d = s->last_q = s->since_voltage = s->voltage = s->mean_seen_q = s->moves = C(0);
    s->behind = C(0);
    s->since_frequency = s->mean_frequency = p->f0 + first;
}

dq_check dq_init(dq_state *s, const dq_params *p)
{
    dq_check found;

    memset(s, 0, sizeof *s);
    found = dq_set(s, p);
    s->share = C(1);
    if (found != DQ_PARAMS_OK) {
        s->mode = DQ_MODE_FAULT;
        s->fault = DQ_FAULT_PARAMETERS;
        return found;
    }
    s->told = p->temperature;
    rest(s);
    return DQ_PARAMS_OK;
}

/* An input within its range; the last good one where it is not finite. */
static void hold(dq_state *s, dq_real *last, dq_real given, dq_real low, dq_real high)
{
    if (finite_real(given))
        *last = clip(given, low, high);
    if (!same(*last, given))
        s->held++;
}

static void hold_inputs(dq_state *s, const dq_input *in)
{
    const dq_params *p = &s->params;

    hold(s, &s->reference, in->reference, C(0), p->amplitude);
    hold(s, &s->share, in->share, C(0), C(1));
    if (size_of(p->k_T) > C(0))
        hold(s, &s->told, in->temperature, p->temperature_lowest, p->temperature_highest);
    hold(s, &s->stated_voltage, in->voltage, p->voltage_lowest, p->voltage_highest);
    hold(s, &s->stated_offset, in->offset, s->window_lowest, s->window_highest);
    s->arrived = C(1);
    if (in->samples != 0u && p->samples > C(0))
        s->arrived = (dq_real)(int32_t)(in->samples - s->samples) * (C(1) / p->samples);
    s->samples = in->samples;
    if (in->task < DQ_TASK_REGULATE || in->task > DQ_TASK_SWEEP)
        s->held++;
    else if (s->mode == DQ_MODE_OFF)
        s->task = in->task;
}

static int is_open(int32_t mode)
{
    return mode == DQ_MODE_OPEN_LOOP || mode == DQ_MODE_SWEEP;
}

static int drives(int32_t mode)
{
    return (mode >= DQ_MODE_FIND && mode <= DQ_MODE_RUN) || is_open(mode);
}

/* The amplitude that is asked of the loop in this mode. */
static dq_real asked_of(const dq_state *s)
{
    const dq_params *p = &s->params;
    const dq_real risen = s->asked + p->ramp;

    if (is_open(s->mode))
        return size_of(p->gain * s->stated_voltage);
    if (s->mode > DQ_MODE_SOFT_START)
        return s->reference;
    if (s->mode == DQ_MODE_SOFT_START)
        return risen > s->reference ? s->reference : risen;
    return s->reference < p->find ? s->reference : p->find;
}

/* What is stated in open loop; a sweep ends without voltage. */
static command stated(dq_state *s)
{
    const int upwards = s->stated_offset < C(0);
    const dq_real end = -s->stated_offset;
    command c = {s->stated_voltage, s->params.f0 + s->stated_offset};

    if (s->mode == DQ_MODE_SWEEP) {
        const int over = upwards ? s->swept > end : s->swept < end;

        c.frequency = s->params.f0 + s->swept;
        c.voltage = over ? C(0) : c.voltage;
        if (!over)
            s->swept = upwards ? s->swept + s->params.sweep : s->swept - s->params.sweep;
    }
    return c;
}

static request requested(dq_state *s)
{
    const dq_params *p = &s->params;
    const dq_real asked = asked_of(s);
    /* While it looks, the heaviest finger may lie on the plate; then the plate has shown what it needs. */
    const dq_real least = C(1) / size_of(p->gain), most = p->heaviest * least;
    const dq_real capped = p->headroom * asked * (s->mode == DQ_MODE_FIND ? most : clip(s->needs, least, most));
    const int starts = s->mode >= DQ_MODE_FIND && s->mode <= DQ_MODE_LOCK;
    request r;

    r.reference = asked;
    r.least = s->mode == DQ_MODE_RUN ? p->find : C(0);
    r.share = s->share;
    r.highest = starts && capped < p->voltage_highest ? capped : p->voltage_highest;
    r.lowest = clip(p->voltage_lowest, -r.highest, C(0));
    r.frozen = s->task != DQ_TASK_REGULATE;
    r.open = is_open(s->mode);
    r.stated = stated(s);
    return r;
}

/* Whether the mean reading is near to what is asked; half as strict while the resonance is looked for. */
static int is_near(const dq_state *s, dq_real asked)
{
    const dq_params *p = &s->params;
    const int rough = s->mode == DQ_MODE_FIND;
    const dq_real off = asked * (rough ? ROUGH : NEAR), error = s->mean_d - asked;
    const dq_real turned = s->mean_d * (rough ? p->beside_find : p->beside_lock);
    const int beside = s->mean_q < turned && s->mean_q > -turned;

    return asked > C(0) && error < off && error > -off && (beside || s->task != DQ_TASK_REGULATE);
}

/* Whether the mean voltage is the one that the identified plate needs for what the sensor shows. Beside its resonance
 * W = G V / (1 - j q/d), so that G V d = d^2 + q^2. */
static int fits(const dq_state *s)
{
    const dq_params *p = &s->params;
    const dq_real makes = p->gain * s->mean_voltage * s->mean_d, size = s->mean_d * s->mean_d + s->mean_q * s->mean_q;
    const int least = s->mode == DQ_MODE_FIND || makes > p->voltage_least * size;

    return least && (makes < p->voltage_most * size || s->task != DQ_TASK_REGULATE);
}

/* Samples in run for which the amplitude has not been what is asked, or the voltage none that a plate needs for it, less those
 * for which both were right: a swing passes through what is right. */
static int32_t follow_fault(dq_state *s)
{
    const dq_params *p = &s->params;
    const dq_real slip = s->mean_asked - s->mean_d, room = NEAR * s->mean_asked, turned = p->beside_run * s->mean_d;
    const int beside = (s->mean_q > turned || s->mean_q < -turned) && s->task == DQ_TASK_REGULATE;
    const int slips = slip > room || slip < -room || beside;
    const dq_real makes = p->gain * s->mean_voltage;
    const int hard = makes > p->voltage_run * s->mean_d && s->task == DQ_TASK_REGULATE;
    const int odd = makes < p->voltage_least * s->mean_d || hard;
    const int judged = s->mode == DQ_MODE_RUN && s->mean_asked > p->find;

    s->off = !judged ? 0 : slips || odd ? s->off + 1 : s->off - (s->off > 0);
    if (s->off < p->follows)
        return DQ_FAULT_NONE;
    return slips ? DQ_FAULT_FOLLOW : DQ_FAULT_MODEL;
}

/* Turns of the voltage about its mean, one soon after the other. */
static int32_t swing_fault(dq_state *s, dq_real voltage, dq_real highest)
{
    const dq_params *p = &s->params;
    const dq_real far = p->swing * highest, beside = voltage - s->mean_voltage;
    const int side = beside > far ? 1 : beside < -far ? -1 : 0;
    const int judged = s->mode == DQ_MODE_LOCK || s->mode == DQ_MODE_RUN;
    const int turned = side * s->side < 0;

    if (turned)
        s->swung = s->swung + 1;
    else if (s->since_swing >= p->swing_time)
        s->swung = 0;
    s->since_swing = turned ? 0 : s->since_swing < p->swing_time ? s->since_swing + 1 : s->since_swing;
    s->side = side != 0 ? side : s->side;
    if (!judged)
        s->swung = 0;
    return s->swung >= p->swings ? DQ_FAULT_OSCILLATES : DQ_FAULT_NONE;
}

/* Mean readings, and what has been asked and driven. */
static void remember(dq_state *s, reading W, dq_real asked, dq_real voltage)
{
    const dq_real share_of_new = s->params.memory;

    if (W.there) {
        s->mean_d = s->mean_d + share_of_new * (W.d - s->mean_d);
        s->mean_q = s->mean_q + share_of_new * (W.q - s->mean_q);
    }
    s->mean_voltage = s->mean_voltage + share_of_new * (voltage - s->mean_voltage);
    s->mean_asked = s->mean_asked + share_of_new * (asked - s->mean_asked);
}

/* The resonance as it has been learned, above f0, at the temperature of f0. */
static dq_real learned_of(const dq_state *s)
{
    const dq_params *p = &s->params;
    const dq_real estimate = p->law == DQ_LAW_ADAPTIVE ? s->resonance : s->estimate;

    if (p->tracker == DQ_TRACKER_NONE)
        return C(0);
    return estimate - p->k_T * (s->temperature - p->temperature);
}

/* The mode after this one, without a fault. */
static int32_t next_mode(const dq_state *s, dq_real asked, const dq_input *in)
{
    static const int32_t open[2] = {DQ_MODE_OPEN_LOOP, DQ_MODE_SWEEP};
    const int done = s->near >= s->params.settled;

    if (s->mode == DQ_MODE_FAULT)
        return in->reset != 0 && in->enable == 0 && s->fault != DQ_FAULT_PARAMETERS ? DQ_MODE_OFF : DQ_MODE_FAULT;
    if (in->enable == 0)
        return DQ_MODE_OFF;
    if (s->mode == DQ_MODE_OFF) {
        if (s->task >= DQ_TASK_OPEN_LOOP)
            return open[s->task - DQ_TASK_OPEN_LOOP];
        return s->reference > C(0) ? DQ_MODE_FIND : DQ_MODE_OFF;
    }
    if (s->mode == DQ_MODE_FIND && done)
        return DQ_MODE_SOFT_START;
    if (s->mode == DQ_MODE_SOFT_START && asked >= s->reference)
        return DQ_MODE_LOCK;
    return s->mode == DQ_MODE_LOCK && done ? DQ_MODE_RUN : s->mode;
}

/* Faults of the machine itself, the guard's `found` before them. */
static int32_t machine_fault(dq_state *s, int32_t found, dq_real asked, dq_real voltage, dq_real highest)
{
    const int waits = (s->mode == DQ_MODE_FIND || s->mode == DQ_MODE_LOCK) && asked > C(0);
    const int close = is_near(s, asked), suits = fits(s);
    const int32_t follow = follow_fault(s), swings = swing_fault(s, voltage, highest);

    /* In find it leaks, as half of the small amplitude may be noise; in lock it has to be so without a break. */
    s->near = !waits ? 0 : close && suits ? s->near + 1 : s->mode == DQ_MODE_FIND ? s->near - (s->near > 0) : 0;
    s->waited = waits ? s->waited + 1 : 0;
    if (found != DQ_FAULT_NONE)
        return found;
    if (s->waited >= s->params.lost)
        return close && !suits ? DQ_FAULT_MODEL : DQ_FAULT_LOST;
    return follow != DQ_FAULT_NONE ? follow : swings;
}

/* The law, then the guard: what is driven, and the fault that there is. */
static int32_t drive(dq_state *s, const dq_input *in, reading W, const request *r, command *c)
{
    const dq_params *p = &s->params;
    reading told = W;

    told.there = believed(s, W);
    if (r->open) {
        *c = r->stated;
    } else if (p->law == DQ_LAW_ADAPTIVE) {
        *c = adaptive_law(s, r, told, s->told);
    } else {
        const int braked = p->kp > C(0) ? s->output < C(0) : s->output > C(0);
        dq_real offset = s->offset;

        c->voltage = amplitude_loop(s, r, told);
        if (p->tracker != DQ_TRACKER_NONE && !r->frozen)
            offset = track(s, r, told, s->told, braked);
        c->frequency = p->f0 + offset;
    }
    return supervise(s, r, W, told.there, in->clipped != 0, c);
}

static reading corrected(const dq_params *p, const dq_input *in)
{
    reading W;
    dq_real size;

    W.d = in->wd * p->sensor_d - in->wq * p->sensor_q;
    W.q = in->wd * p->sensor_q + in->wq * p->sensor_d;
    size = W.d * W.d + W.q * W.q; /* one whose fourth power overflows is none: nothing made of it would be finite */
    W.there = finite_real(size * size);
    return W;
}

dq_output dq_step(dq_state *s, const dq_input *in)
{
    const dq_params *p = &s->params;
    const int32_t was = s->mode;
    dq_output out = {C(0), C(0), C(0), DQ_FAULT_PARAMETERS, DQ_MODE_FAULT, 0u};
    command c = {C(0), C(0)};
    request r;
    reading W;
    int on;

    if (s->fault == DQ_FAULT_PARAMETERS)
        return out;
    hold_inputs(s, in);
    W = corrected(p, in);
    on = drives(was) && in->enable != 0;
    r = requested(s);
    if (on) {
        const int32_t found = drive(s, in, W, &r, &c);

        remember(s, W, r.reference, c.voltage);
        if (was == DQ_MODE_FIND && s->mean_d > C(0))
            s->needs = size_of(s->mean_voltage) / s->mean_d;
        s->fault = machine_fault(s, found, r.reference, c.voltage, r.highest);
    } else {
        remember(s, W, C(0), C(0));
        s->near = s->waited = s->off = s->swung = 0;
    }
    s->mode = s->fault != DQ_FAULT_NONE && was != DQ_MODE_FAULT ? DQ_MODE_FAULT : next_mode(s, r.reference, in);
    if (s->mode == DQ_MODE_OFF)
        s->fault = DQ_FAULT_NONE;
    if (s->mode != was)
        s->near = s->waited = s->off = 0;
    on = on && drives(s->mode);
    s->asked = r.reference;
    if (on && was == DQ_MODE_RUN)
        s->learned = learned_of(s);
    if (s->mode == DQ_MODE_FAULT)
        s->learned = C(0);
    if (!on) {
        rest(s);
        c.voltage = C(0);
        c.frequency = p->f0 + s->offset;
    }
    out.voltage = c.voltage;
    out.frequency = c.frequency;
    out.offset = c.frequency - p->f0;
    out.fault = s->fault;
    out.mode = s->mode;
    out.held = s->held;
    return out;
}

/* --- the demodulator ---------------------------------------------------------------------------------------------------- */

/* Series of sin and cos of u pi/4. */
#define S1 C(0.78539816339744828)
#define S3 C(-0.080745512188280771)
#define S5 C(0.0024903945701927198)
#define S7 C(-3.6576204182177239e-05)
#define C2 C(-0.30842513753404244)
#define C4 C(0.015854344243815498)
#define C6 C(-0.00032599188692738996)
#define C8 C(3.5908604485915088e-06)

/* cos and sin of the angle of an accumulator, right to 3.2e-7: series about the nearest multiple of a quarter turn. */
static void cos_and_sin(uint32_t phase, dq_real *cosine, dq_real *sine)
{
    const uint32_t turn = phase + 0x20000000u;
    const dq_real u = (dq_real)((int32_t)(turn & 0x3fffffffu) * 2 - 1073741824) * C(9.31322574615478516e-10), x = u * u;
    const dq_real s = u * (S1 + x * (S3 + x * (S5 + x * S7))), c = C(1) + x * (C2 + x * (C4 + x * (C6 + x * C8)));
    const int odd = (int)(turn >> 30 & 1u), half = (int)(turn >> 31);
    const dq_real near_cos = odd ? -s : c, near_sin = odd ? c : s;

    *cosine = half ? -near_cos : near_cos;
    *sine = half ? -near_sin : near_sin;
}

void dq_demodulator_init(dq_demodulator *s, const dq_params *p)
{
    memset(s, 0, sizeof *s);
    s->share = p->demodulator_share;
    s->scale = C(2) * p->demodulator_scale;
    s->most = p->sample_most;
    s->patience = p->sample_patience;
}

dq_response dq_demodulate(dq_demodulator *s, dq_real sample, uint32_t phase)
{
    dq_response out;

    if (finite_real(sample)) {
        dq_real c, sn, d, q;
        int k;

        cos_and_sin(phase, &c, &sn);
        d = -(s->scale * sample) * c;
        q = s->scale * sample * sn;
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC unroll 4 /* a tenth fewer instructions on a Cortex-M4F at -O2, which does not of itself */
#endif
        for (k = 0; k < 4; k++) {
            d = s->poles[k].d = s->poles[k].d + s->share * (d - s->poles[k].d);
            q = s->poles[k].q = s->poles[k].q + s->share * (q - s->poles[k].q);
        }
        s->samples++;
        s->missed = 0;
        s->clipped = sample >= s->most || sample <= -s->most ? s->patience : s->clipped - (s->clipped > 0);
    } else if (s->missed < s->patience) {
        s->missed++;
    }
    out.wd = s->missed >= s->patience ? (dq_real)NAN : s->poles[3].d;
    out.wq = s->missed >= s->patience ? (dq_real)NAN : s->poles[3].q;
    out.clipped = s->clipped > 0;
    out.samples = s->samples;
    return out;
}

int dq_self_test(void)
{
    static const dq_real sixteenth[16] = {/* cosines of multiples of a sixteenth of a turn */
        C(1), C(0.92387953251128674), C(0.70710678118654752), C(0.38268343236508977), C(0), C(-0.38268343236508977),
        C(-0.70710678118654752), C(-0.92387953251128674), C(-1), C(-0.92387953251128674), C(-0.70710678118654752),
        C(-0.38268343236508977), C(0), C(0.38268343236508977), C(0.70710678118654752), C(0.92387953251128674)};
    dq_demodulator s = {C(0.2), C(2), C(10), 16, 0, 0, 0u, {{C(0), C(0)}, {C(0), C(0)}, {C(0), C(0)}, {C(0), C(0)}}};
    dq_response out = {C(0), C(0), 0, 0u};
    uint32_t k;

    for (k = 0; k < 400; k++) { /* w = -Wd cos p + Wq sin p */
        const dq_real w = C(-0.8) * sixteenth[k % 16] - C(0.6) * sixteenth[(k + 12) % 16];

        out = dq_demodulate(&s, w, k << 28);
    }
    /* the image at twice the carrier: (0.2 / |1 - 0.8 e^{-j pi/4}|)^4 = 0.006 of it is left */
    return !(out.wd > C(0.79) && out.wd < C(0.81) && out.wq > C(-0.61) && out.wq < C(-0.59));
}

/* --- what a rig takes --------------------------------------------------------------------------------------------------- */

int32_t dq_dac_code(dq_real voltage, int32_t bits, dq_real full_scale)
{
    const dq_real most = (dq_real)(((int32_t)1 << (bits - 1)) - 1);

    return (int32_t)clip(floor_of(voltage * ((most + C(1)) / full_scale) + C(0.5)), -most, most);
}

dq_real dq_duty(dq_real voltage, dq_real limit, const dq_real *a, int32_t terms)
{
    const dq_real x = voltage * (C(1) / limit), square = x * x;
    dq_real found = C(0);
    int32_t k;

    for (k = terms - 1; k >= 0; k--)
        found = found * square + a[k];
    return found * x;
}

uint32_t dq_timer_ticks(const dq_params *p, dq_real offset)
{
    return (uint32_t)(int32_t)(p->source_periods + ticks_beyond(p, offset));
}

uint32_t dq_dds_increment(dq_real offset, uint32_t base, dq_real fraction, dq_real per_hz)
{
    return base + (uint32_t)(int32_t)floor_of(offset * per_hz + (C(0.5) + fraction));
}
