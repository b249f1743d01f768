/* What the example needs of a board: two timers that interrupt, a converter each way that acts at the
 * sample timer's event, somewhere to write to. `board_mps2.c` is the emulator's; another board needs
 * another such file and nothing else. */
#ifndef BOARD_H
#define BOARD_H

#include <stdint.h>

/* Everything but the interrupts. */
void board_init(void);
/* Both timers: `sample_interrupt` at the rate of the samples, and below it in priority `control_interrupt` every
 * `microseconds`. */
void board_start(uint32_t microseconds);
void sample_interrupt(void);
void control_interrupt(void);

/* The code that the converter took at the event that led to this interrupt. Called once in each sample
 * interrupt. */
int32_t board_adc(void);
/* The drive in volts, to be put out at the next event and held until the one after it. */
void board_dac(float volts);

/* Until an interrupt, or for a moment. */
void board_wait(void);
/* Nothing interrupts between these. */
void board_lock(void);
void board_unlock(void);

void board_write(const char *text);
/* Ends the program; 0: all is well. */
void board_exit(int status);

/* Counts down from 2^24 - 1 at 25 MHz, round and round. */
uint32_t board_clock(void);
/* Bytes of stack that have been used since board_init, at most. */
uint32_t board_stack(void);

#endif
