/* A plate at its carrier with the drive and the sensor of a bench. It knows nothing of the controller, nor
 * of its simulation.
 *
 * Each resonance obeys  w'' + (2/tau) w' + w0^2 w = N u,  N = 2 G w0 / tau,  u the amplifier's output. With
 * the pole s = -1/tau + j sqrt(w0^2 - 1/tau^2), the number c = w' - conj(s) w obeys c' = s c + N u: a tick
 * is integrated exactly for a u that is a sine plus a straight line, and w = Im c / Im s. A drive of V sin
 * p has Wd + j Wq = (w - j w'/omega) e^{-j theta} with theta = p + pi. */
#ifndef PLANT_H
#define PLANT_H

#include "bench.h"

#include <complex.h>
#include <stdint.h>

#define RESONANCES 2
#define REMEMBERED 4096 /* ticks of motion, for the sensor's delay */

typedef struct {
    double complex pole, c;
    /* what a tick makes of c, of a sine's two halves, of 1, of a ramp to 1 */
    double complex decay, with, against, held, rising;
    double force;
} resonance;

typedef struct {
    double tick; /* s */
    resonance modes[RESONANCES];
    double key[9]; /* what the numbers of a tick were computed for */
    uint32_t phase, increment; /* of the synthesiser, per tick */
    uint32_t shown; /* the phase that its output holds */
    double peak; /* commanded voltage */
    double output; /* of the amplifier, now */
    double largest_motion, largest_output; /* since they were last read */
    double complex memory[REMEMBERED];
    long now;
    double code; /* the last of the converter */
    uint64_t chance;
} plant;

void plant_init(plant *p, const settings *s);
/* One tick under the command in force. */
void plant_tick(plant *p, const settings *s);
void plant_command(plant *p, const settings *s, double voltage, double frequency);
/* Peak amplitude; and Wd + j Wq against the drive's phase. */
double plant_amplitude(const plant *p);
double complex plant_response(const plant *p);
/* What the converter gives, in counts or, without one, in the response's unit. */
double plant_sample(plant *p, const settings *s);
/* Even in 0..1. */
double plant_chance(plant *p);
double plant_frequency(const plant *p);

#endif
