"""The C99 that an export is made of, around the recorded steps."""

HEADER = """\
/* Amplitude and frequency controller of one identified plate. Generated: do not edit.
 *
 * {stamp}
 *
 * {use}
 *
 * A step has no loop and no heap, remembers nothing but its state, and takes the same operations whatever comes in:
 * {operations}.
{arithmetic} */
#ifndef {guard}
#define {guard}

#include <stdint.h>

typedef {type} {number};
{missing}
typedef struct {{
{fields}
}} dq_state;

typedef struct {{
{inputs}
}} dq_input;

typedef struct {{
{outputs}
}} dq_output;

/* Off, without a fault. */
void dq_init(dq_state *s);
/* One step of the controller, every {sample_time} s. */
dq_output dq_step(dq_state *s, const dq_input *in);
{demodulator}
#endif
"""

DEMODULATOR_H = """
typedef struct {{
{fields}
}} dq_demodulator;

typedef struct {{
    {number} wd;
    {number} wq;
}} dq_response;

/* At rest. */
void dq_demodulator_init(dq_demodulator *s);
/* One sample of the sensor, {rate} times a second: {sample}.
 * `phase` is the accumulator's when it was taken, 2^32 a turn, with a drive of V sin(phase). One step takes
 * {operations}.
 * Of the image at twice the carrier {image:.2g} of W is left, W is late by {delay:.3g} s; sine and cosine are right to
 * 3.2e-7{coarse}. */
dq_response dq_demodulate(dq_demodulator *s, {sample_type} sample, uint32_t phase);
/* Demodulates {count} samples that stand in the source and compares: 0 where Wd and Wq are what they are in Python. */
int dq_self_test(void);
"""

SOURCE = """\
/* Generated with {header}: do not edit. */
#include "{header}"
{helpers}
void dq_init(dq_state *s)
{{
{init}
}}

dq_output dq_step(dq_state *s, const dq_input *in)
{{
    dq_output out;
{lines}
{after}
{out}
    return out;
}}
{demodulator}"""

DEMODULATOR_C = """
void dq_demodulator_init(dq_demodulator *s)
{{
{init}
}}

dq_response dq_demodulate(dq_demodulator *s, {sample_type} sample, uint32_t phase)
{{
    dq_response out;
    const uint32_t turn = phase + 0x20000000u;
    const int odd = (int)(turn >> 30 & 1u), half = (int)(turn >> 31);
    const {number} u = {turn};
{lines}
{after}
{out}
    return out;
}}

int dq_self_test(void)
{{
    static const {sample_type} samples[] = {{
{samples}
    }};
    dq_demodulator s;
    dq_response out = {{0, 0}};
    uint32_t phase = {phase}u;
    unsigned i;

    dq_demodulator_init(&s);
    for (i = 0; i < sizeof samples / sizeof samples[0]; i++) {{
        out = dq_demodulate(&s, samples[i], phase);
        phase += {advance}u;
    }}
    return !({near});
}}
"""

# 1 << 23 and 1 << 52: from there on a floating-point number is whole.
FLOATING = """
#include <math.h> /* for the macros isfinite and NAN alone */

#define DQ_MISSING ((dq_real)NAN)
{floor}"""

FLOOR = """
static dq_real dq_floor(dq_real x)
{{
    dq_real whole;

    if (!(x < {whole} && x > -{whole}))
        return x;
    whole = (dq_real)({integer})x;
    return whole > x ? whole - {one} : whole;
}}
"""

FIXED = """
typedef {wide} dq_wide;
{called}"""

FIXED_MISSING = """#define DQ_TOP {top}
#define DQ_MISSING (-DQ_TOP - 1)
"""

FIT = """
/* x 2^-shift, to the nearest and halves away from zero, within +-DQ_TOP */
static dq_word dq_fit(dq_wide x, int shift)
{
    if (shift > 0) {
        const dq_wide half = (dq_wide)1 << (shift - 1);
        x = x < 0 ? -((half - x) >> shift) : (x + half) >> shift;
    }
    return (dq_word)(x > DQ_TOP ? DQ_TOP : x < -DQ_TOP ? -DQ_TOP : x);
}
"""

RATIO = """
/* a / b, its fraction cut off, within +-most; b below one counts as one */
static dq_word dq_ratio(dq_wide a, dq_word b, dq_word most)
{
    const dq_wide x = a / (b < 1 ? 1 : b);
    return x > most ? most : x < -most ? (dq_word)-most : (dq_word)x;
}
"""

FIXED_FLOOR = """
/* the largest whole number not above a 2^-point */
static dq_word dq_floor(dq_word a, int point)
{
    const dq_wide x = a, unit = (dq_wide)1 << point;
    return (dq_word)(x < 0 ? -((unit - 1 - x) >> point) : x >> point);
}
"""

FLOAT_NOTES = """\
 * A division is of a number by one that has been compared with its limit before, and is right to half a unit in the last place.
 * Compile without contraction and without fast math (-ffp-contract=off): a fused multiply-add changes the last bit,
 * and fast math removes the test for a missing (not finite) measurement."""

FIXED_NOTES = """\
 * A word n stands for n 2^-k, k as stated beside it; DQ_MISSING, -2^{sign}, for a measurement that is not there. All arithmetic
 * rounds to the nearest and saturates; the quotient of a division is bounded, and right to one unit in its last place."""
