/* See plant.h. */
#include "plant.h"

#include <math.h>

#define PI 3.14159265358979323846
#define TURN 4294967296.0

static double clipped(double value, double most)
{
    return value > most ? most : value < -most ? -most : value;
}

static double complex turn(uint32_t phase)
{
    return cexp(I * (2 * PI / TURN * phase));
}

/* (e^x - 1) / x, also for a small x. */
static double complex growth(double complex x)
{
    if (cabs(x) < 1e-2)
        return 1 + x / 2 * (1 + x / 3 * (1 + x / 4 * (1 + x / 5 * (1 + x / 6))));
    return (cexp(x) - 1) / x;
}

double plant_chance(plant *p)
{
    uint64_t z = (p->chance += 0x9e3779b97f4a7c15u); /* splitmix64 */
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return (double)((z ^ (z >> 31)) >> 11) / 9007199254740992.0;
}

static double normal(plant *p)
{
    double u = 1 - plant_chance(p);
    return sqrt(-2 * log(u)) * cos(2 * PI * plant_chance(p));
}

/* The resonance of a plate, and what a tick of sine at `omega` makes of it. The motion w and w' goes on
 * when the pole changes. */
static void prepare(resonance *m, double G, double tau, double damping, double f0, double omega, double h)
{
    double w0 = 2 * PI * f0, a = damping / tau;
    double w = m->pole == 0 ? 0 : cimag(m->c) / cimag(m->pole);
    double speed = creal(m->c) + creal(m->pole) * w;
    m->pole = -a + I * sqrt(w0 * w0 - a * a);
    m->c = speed - conj(m->pole) * w;
    m->force = 2 * G * w0 / tau; /* no finger changes the force */
    m->decay = cexp(m->pole * h);
    /* the integral over a tick of e^{s (h - r)} times e^{j omega r}, e^{-j omega r}, 1 and r/h */
    m->with = m->decay * growth((I * omega - m->pole) * h) * h;
    m->against = m->decay * growth((-I * omega - m->pole) * h) * h;
    m->held = growth(m->pole * h) * h;
    m->rising = (growth(m->pole * h) - 1) / m->pole;
}

static double omega_of(const plant *p)
{
    return 2 * PI * p->increment / TURN / p->tick;
}

static void prepare_all(plant *p, const settings *s)
{
    double warmed = s->k_T * (s->temperature - 24);
    double key[9] = {s->G, s->tau, s->f0, warmed, s->finger, s->G2, s->tau2, s->f2, p->increment};
    int same = 1;
    for (int k = 0; k < 9; k++) {
        same = same && key[k] == p->key[k];
        p->key[k] = key[k];
    }
    if (same)
        return;
    prepare(&p->modes[0], s->G, s->tau, 1 + s->finger, s->f0 + warmed, omega_of(p), p->tick);
    prepare(&p->modes[1], s->G2, s->tau2, 1, s->f2, omega_of(p), p->tick);
}

/* w - j w'/omega of the plate: Wd + j Wq, turning. */
static double complex motion(const plant *p)
{
    double w = 0, speed = 0, omega = omega_of(p);
    for (int k = 0; k < RESONANCES; k++) {
        const resonance *m = &p->modes[k];
        double own = cimag(m->c) / cimag(m->pole);
        w += own;
        speed += creal(m->c) + creal(m->pole) * own;
    }
    return w - I * speed / omega;
}

void plant_init(plant *p, const settings *s)
{
    *p = (plant){.tick = 1 / (s->rate * s->ticks), .chance = (uint64_t)s->seed};
    p->increment = 1;
    plant_command(p, s, 0, s->f0);
    prepare_all(p, s);
}

void plant_command(plant *p, const settings *s, double voltage, double frequency)
{
    double made = s->timer > 0 ? s->timer / round(s->timer / frequency) : frequency;
    if (s->dac_bits > 0) {
        double most = ldexp(1, (int)s->dac_bits - 1), code = round(voltage / s->dac_full * most);
        voltage = clipped(code, most - 1) * s->dac_full / most;
    }
    p->peak = isfinite(voltage) ? voltage : 0;
    if (isfinite(made) && made > 0 && made * p->tick < 0.5)
        p->increment = (uint32_t)lround(made * p->tick * TURN);
}

/* What the amplifier's output reaches at the end of a tick towards `wanted`. */
static double amplified(const plant *p, const settings *s, double wanted)
{
    return p->output + clipped(clipped(wanted, s->rail) - p->output, s->slew * p->tick);
}

void plant_tick(plant *p, const settings *s)
{
    double sine = s->hold > 0 ? 0 : s->amplifier * p->peak; /* of the part that is a sine */
    double complex here;
    double first, last, ideal;
    prepare_all(p, s);
    if (s->hold > 0 && p->now % (long)s->hold == 0)
        p->shown = p->phase;
    here = turn(p->phase);
    if (s->hold > 0) { /* at once, or as fast as the amplifier slews */
        double wanted = s->amplifier * p->peak * cimag(turn(p->shown)), after = amplified(p, s, wanted);
        first = s->slew < 1e29 ? p->output : after;
        last = after;
        ideal = 0;
    } else {
        double start = sine * cimag(here);
        ideal = sine * cimag(turn(p->phase + p->increment));
        first = s->slew < 1e29 ? p->output - start : clipped(start, s->rail) - start;
        last = amplified(p, s, ideal) - ideal;
    }
    for (int k = 0; k < RESONANCES; k++) {
        resonance *m = &p->modes[k];
        double complex wave = sine * (here * m->with - conj(here) * m->against) / (2 * I);
        m->c = m->decay * m->c + m->force * (wave + first * m->held + (last - first) * m->rising);
    }
    p->output = ideal + last;
    p->largest_output = fmax(p->largest_output, fabs(p->output));
    p->phase += p->increment;
    p->now++;
    p->memory[p->now % REMEMBERED] = motion(p);
    p->largest_motion = fmax(p->largest_motion, plant_amplitude(p));
}

double plant_amplitude(const plant *p)
{
    return cabs(p->memory[p->now % REMEMBERED]);
}

double complex plant_response(const plant *p)
{
    return -p->memory[p->now % REMEMBERED] * conj(turn(p->phase));
}

double plant_frequency(const plant *p)
{
    return p->increment / TURN / p->tick;
}

double plant_sample(plant *p, const settings *s)
{
    /* whole ticks from the memory; what is left of a tick only turns the carrier */
    long late = lround(s->delay / p->tick);
    double beside = omega_of(p) * (s->delay - (double)late * p->tick);
    double complex seen = late < REMEMBERED && late <= p->now ? p->memory[(p->now - late) % REMEMBERED] : 0;
    double value = s->gain * creal(seen * cexp(I * (s->rotation * PI / 180 - beside)));
    value = clipped(value + s->offset + (s->noise > 0 ? s->noise * normal(p) : 0), s->clip);
    if (s->bits > 0) {
        double most = ldexp(1, (int)s->bits - 1);
        value = round(value / s->full * most);
        value = value > most - 1 ? most - 1 : value < -most ? -most : value;
    }
    if (s->stuck == 0)
        p->code = value;
    return p->code;
}
