/* The emulator's board: MPS2 with the AN386 image (Cortex-M4F, 25 MHz timers). It has no converters, so the
 * plate is computed here: a resonator, exact from one event to the next under a held drive, behind an ADC
 * of 12 bits. */
#include "board.h"

#include "dq_pi_plate.h"

#include <math.h>

#define REGISTER(address) (*(volatile uint32_t *)(address))
#define TIMER(n, offset) REGISTER(0x40000000u + 0x1000u * (n) + (offset)) /* control 0, reload 8, clear 12 */
#define UART(offset) REGISTER(0x40004000u + (offset)) /* data 0, state 4, control 8, divider 16 */
#define SYSTICK(offset) REGISTER(0xe000e010u + (offset)) /* control 0, reload 4, value 8 */
#define NVIC_ENABLE REGISTER(0xe000e100u)
#define NVIC_PRIORITY(n) (*(volatile uint8_t *)(0xe000e400u + (n)))
#define SAMPLE_TICKS 48u /* of 25 MHz */
#define TIMER0_IRQ 8u
#define TIMER1_IRQ 9u
#define PAINT 0xa5a5a5a5u

/* The plate that is computed is the identified one, unless it is stated to be another. */
#ifndef PLATE_G
#define PLATE_G DQ_PLATE_GAIN
#endif
#ifndef PLATE_F0
#define PLATE_F0 DQ_PLATE_F0
#endif
#define PLATE_TAU DQ_PLATE_TAU

_Static_assert((int)DQ_PLATE_SAMPLE_RATE == 520833, "export with the rig of rig.toml: 25 MHz / 48 samples a second");

extern uint32_t stack_begin, stack_end;
void timer0_interrupt(void);
void timer1_interrupt(void);

/* With the pole s = -1/tau + j w, c = x' - conj(s) x obeys c' = s c + N u, and x = Im c / w. */
static struct {
    float decay_re, decay_im, push_re, push_im; /* what an event makes of c, and of the drive */
    float c_re, c_im;
    float shown, next; /* volts */
} plate;

static void plate_start(void)
{
    const double w0 = 6.283185307179586 * PLATE_F0, a = 1.0 / PLATE_TAU, w = sqrt(w0 * w0 - a * a);
    const double h = SAMPLE_TICKS / 25e6;
    const double size = exp(-a * h), re = size * cos(w * h), im = size * sin(w * h);
    /* (e^{s h} - 1) / s, times N / w: x in um is then Im c */
    const double gain = 2 * PLATE_G * w0 / PLATE_TAU / w / (w0 * w0);
    plate.decay_re = (float)re;
    plate.decay_im = (float)im;
    plate.push_re = (float)(gain * (-a * (re - 1) + w * im));
    plate.push_im = (float)(gain * (-a * im - w * (re - 1)));
}

int32_t board_adc(void)
{
    const float c = plate.c_re;
    float counts;
    plate.c_re = plate.decay_re * c - plate.decay_im * plate.c_im + plate.push_re * plate.shown;
    plate.c_im = plate.decay_im * c + plate.decay_re * plate.c_im + plate.push_im * plate.shown;
    plate.shown = plate.next;
    counts = plate.c_im * (float)(1 / DQ_PLATE_SAMPLE_SCALE);
    counts = counts > 2047.0f ? 2047.0f : counts < -2048.0f ? -2048.0f : counts;
    return (int32_t)(counts < 0.0f ? counts - 0.5f : counts + 0.5f);
}

void board_dac(float volts)
{
    plate.next = volts;
}

void timer0_interrupt(void)
{
    TIMER(0u, 12u) = 1;
    sample_interrupt();
}

void timer1_interrupt(void)
{
    TIMER(1u, 12u) = 1;
    control_interrupt();
}

void board_init(void)
{
    plate_start();
    UART(16u) = 16;
    UART(8u) = 1;
    SYSTICK(4u) = 0xffffffu;
    SYSTICK(0u) = 5; /* the processor's clock, no interrupt */
    for (uintptr_t at = (uintptr_t)&stack_begin; at < (uintptr_t)__builtin_frame_address(0) - 64; at += 4)
        *(uint32_t *)at = PAINT;
}

void board_start(uint32_t microseconds)
{
    NVIC_PRIORITY(TIMER0_IRQ) = 0x00;
    NVIC_PRIORITY(TIMER1_IRQ) = 0x80;
    NVIC_ENABLE = 1u << TIMER0_IRQ | 1u << TIMER1_IRQ;
    TIMER(0u, 8u) = SAMPLE_TICKS - 1;
    TIMER(1u, 8u) = 25 * microseconds - 1;
    TIMER(0u, 0u) = TIMER(1u, 0u) = 9; /* on, with its interrupt */
}

/* Not by wfi: while the emulated processor sleeps, its time goes on with the host's, and interrupts are lost. */
void board_wait(void)
{
    __asm volatile("nop");
}

void board_lock(void)
{
    __asm volatile("cpsid i" ::: "memory");
}

void board_unlock(void)
{
    __asm volatile("cpsie i" ::: "memory");
}

void board_write(const char *text)
{
    for (; *text; text++) {
        while (UART(4u) & 1u)
            ;
        UART(0u) = (uint8_t)*text;
    }
}

/* By semihosting: SYS_EXIT_EXTENDED, "application exit". */
void board_exit(int status)
{
    const uint32_t block[2] = {0x20026u, (uint32_t)status};
    register uint32_t operation __asm("r0") = 0x20;
    register const uint32_t *argument __asm("r1") = block;
    __asm volatile("bkpt 0xab" ::"r"(operation), "r"(argument) : "memory");
    for (;;)
        ;
}

uint32_t board_clock(void)
{
    return SYSTICK(8u);
}

uint32_t board_stack(void)
{
    uintptr_t at = (uintptr_t)&stack_begin;
    while (at < (uintptr_t)&stack_end && *(const uint32_t *)at == PAINT)
        at += 4;
    return (uint32_t)((uintptr_t)&stack_end - at);
}
