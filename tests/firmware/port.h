/* What the bench needs of a controller: two interrupts. Each controller's own port has these. */
#ifndef PORT_H
#define PORT_H

#include <stdint.h>

typedef struct {
    double wd, wq;
    int clipped;
    uint32_t samples;
} port_response;

typedef struct {
    double reference, share, wd, wq, temperature, voltage, offset;
    int task, clipped, enable, reset, guard;
    uint32_t samples;
} port_input;

typedef struct {
    double voltage, frequency;
    int fault, mode;
} port_output;

/* 0: all is well. */
int port_init(void);
/* A sample, NaN where it is missing; gives Wd and Wq. */
void port_sample(double sample, uint32_t phase, port_response *found);
port_output port_step(const port_input *in);

#endif
