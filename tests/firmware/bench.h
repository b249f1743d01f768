/* The settings of a bench: what a scenario may state, and change at any time. All are doubles, so that one
 * line sets any of them. */
#ifndef BENCH_H
#define BENCH_H

/* name, value where nothing is stated */
#define SETTINGS(X) \
    /* the plate: response per drive at resonance, time constant s, resonance Hz at 24 degC, \
       Hz/degC, degC, a finger's damping in units of the plate's own; a second resonance that the \
       sensor sees as well */ \
    X(G, 0.02) X(tau, 1.669e-3) X(f0, 32300.0) X(k_T, 0.0) X(temperature, 24.0) X(finger, 0.0) \
    X(G2, 0.0) X(tau2, 1e-3) X(f2, 40000.0) \
    /* the drive: the amplifier's gain (negative: its polarity is wrong), rails, slew rate of the \
       carrier itself; ticks for which the synthesiser's output is held (0: a smooth sine); bits \
       and full scale of the converter for the peak voltage */ \
    X(amplifier, 1.0) X(rail, 1e30) X(slew, 1e30) X(hold, 0.0) X(dac_bits, 0.0) X(dac_full, 0.0) \
    /* the timer whose whole ticks make a period of the carrier, Hz; 0: none */ \
    X(timer, 0.0) \
    /* the sensor: gain (negative: polarity), rotation deg, delay s, offset and standard deviation \
       of a sample, clipping of its front end; the converter's bits (0: none, samples in the \
       response's unit), full scale, whether its code is stuck */ \
    X(gain, 1.0) X(rotation, 0.0) X(delay, 0.0) X(offset, 0.0) X(noise, 0.0) X(clip, 1e30) X(bits, 0.0) \
    X(full, 0.0) X(stuck, 0.0) \
    /* shares of the samples that are said to be missing, whose interrupt does not come, and of control \
       interrupts that do not */ \
    X(missing, 0.0) X(lost, 0.0) X(skipped, 0.0) \
    /* what the control interrupt is told: Wd and Wq frozen, or one of them replaced by a number; \
       whether the firmware counts half a hold in the phase that it hands over */ \
    X(frozen, 0.0) X(told_d, NO_SETTING) X(told_q, NO_SETTING) X(counted, 0.0) \
    X(reference, 0.0) X(share, 1.0) X(enable, 1.0) X(reset, 0.0) X(thermometer, NO_SETTING) \
    /* what is to be done (as the controller numbers it), with which voltage and how many Hz above f0; 0: no \
       fault is called */ \
    X(task, 0.0) X(volts, 0.0) X(begin, 0.0) X(guard, 1.0) \
    /* times, s: from a control interrupt to when its command takes effect, between two of them; \
       samples per s, ticks per sample; how long; the seed of noise and chance */ \
    X(latency, 1e-4) X(sample_time, 1e-4) X(rate, 516800.0) X(ticks, 4.0) X(duration, 0.1) X(seed, 1.0)

#define NO_SETTING -1e300 /* nothing is replaced */

typedef struct {
#define FIELD(name, value) double name;
    SETTINGS(FIELD)
#undef FIELD
} settings;

#endif
