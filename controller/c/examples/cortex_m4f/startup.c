/* From reset to main() on a Cortex-M4F: vectors, initial data, the floating-point unit. */
#include <stdint.h>

extern uint32_t data_load, data_begin, data_end, bss_begin, bss_end, stack_end;
int main(void);
void reset(void);
void timer0_interrupt(void);
void timer1_interrupt(void);

#define CPACR (*(volatile uint32_t *)0xe000ed88u)

void reset(void)
{
    uint32_t *to = &data_begin;
    for (const uint32_t *from = &data_load; to < &data_end;)
        *to++ = *from++;
    for (to = &bss_begin; to < &bss_end;)
        *to++ = 0;
    CPACR |= 0xfu << 20;
    __asm volatile("dsb\n\tisb");
    main();
    for (;;)
        ;
}

static void stop(void)
{
    for (;;)
        ;
}

typedef union {
    void *stack;
    void (*handler)(void);
} vector;

#define H(function) {.handler = function}
#define NONE {.stack = 0}

__attribute__((section(".vectors"), used)) static const vector vectors[16 + 10] = {
    {.stack = &stack_end}, H(reset), H(stop), H(stop), H(stop), H(stop), H(stop), NONE, NONE, NONE, NONE,
    H(stop), H(stop), NONE, H(stop), H(stop),
    H(stop), H(stop), H(stop), H(stop), H(stop), H(stop), H(stop), H(stop), H(timer0_interrupt), H(timer1_interrupt),
};
