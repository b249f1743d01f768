/* The exported controller on a bench, as firmware would run it: an interrupt for each sample, one for each
 * control step.
 *
 * Standard input: lines "time name value", in order of time; a setting of bench.h is `value` from then on.
 * Standard output: a record of doubles for each control step, as in RECORD. */
#include "plant.h"
#include "port.h"

#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define LATE 1024 /* commands that may be on their way */

typedef struct {
    double time;
    size_t at; /* of the setting */
    double value;
} event;

typedef struct {
    double voltage, frequency;
    long due;
} command;

typedef struct {
    settings s;
    plant p;
    event *events;
    long count, next;
    command late[LATE];
    long sent, taken;
    port_response response, told; /* as the last sample left it; as the last step was told */
} bench;

static const struct { const char *name; size_t at; } NAMES[] = {
#define NAMED(name, value) {#name, offsetof(settings, name)},
    SETTINGS(NAMED)
#undef NAMED
};

static void set(settings *s, size_t at, double value)
{
    memcpy((char *)s + at, &value, sizeof value);
}

static size_t place(const char *name)
{
    for (size_t k = 0; k < sizeof NAMES / sizeof NAMES[0]; k++)
        if (strcmp(NAMES[k].name, name) == 0)
            return NAMES[k].at;
    fprintf(stderr, "found the setting %s, expected one of bench.h\n", name);
    exit(2);
}

static void read_scenario(bench *b)
{
    char name[64];
    event e;
    b->s = (settings){
#define FIRST(name, value) .name = value,
        SETTINGS(FIRST)
#undef FIRST
    };
    while (scanf("%lf %63s %lf", &e.time, name, &e.value) == 3) {
        e.at = place(name);
        if (e.time <= 0) {
            set(&b->s, e.at, e.value);
            continue;
        }
        if (b->count % 64 == 0)
            b->events = realloc(b->events, (size_t)(b->count + 64) * sizeof e);
        b->events[b->count++] = e;
    }
}

static void sample_interrupt(bench *b)
{
    const settings *s = &b->s;
    double value = plant_sample(&b->p, s);
    /* the output of a hold lags the accumulator by half of it */
    uint32_t phase = b->p.phase - (s->counted != 0 ? (uint32_t)(0.5 * s->hold * b->p.increment) : 0);
    if (plant_chance(&b->p) < s->lost)
        return;
    port_sample(plant_chance(&b->p) < s->missing ? NAN : value, phase, &b->response);
}

static double replaced(double setting, double value)
{
    return setting == NO_SETTING ? value : setting;
}

static port_output control_interrupt(bench *b)
{
    const settings *s = &b->s;
    port_input in = {
        .reference = s->reference, .share = s->share, .temperature = replaced(s->thermometer, s->temperature),
        .voltage = s->volts, .offset = s->begin, .task = (int)s->task,
        .enable = s->enable != 0, .reset = s->reset != 0,
        .guard = s->guard != 0,
    };
    port_output out;
    command *c = &b->late[b->sent++ % LATE];
    if (s->frozen == 0)
        b->told = b->response;
    in.wd = replaced(s->told_d, b->told.wd);
    in.wq = replaced(s->told_q, b->told.wq);
    in.clipped = b->told.clipped;
    in.samples = b->told.samples;
    out = port_step(&in);
    *c = (command){out.voltage, out.frequency, b->p.now + lround(s->latency / b->p.tick)};
    return out;
}

static void record(bench *b, double time, const port_output *out)
{
    double complex Z = plant_response(&b->p);
    double row[] = {time, creal(Z), cimag(Z), b->p.largest_motion, b->p.largest_output, b->told.wd,
                    b->told.wq, out->voltage, out->frequency, plant_frequency(&b->p), b->s.reference,
                    out->fault, out->mode};
    fwrite(row, sizeof row, 1, stdout);
    b->p.largest_motion = b->p.largest_output = 0;
}

static void happen(bench *b, double time)
{
    for (; b->next < b->count && b->events[b->next].time <= time; b->next++)
        set(&b->s, b->events[b->next].at, b->events[b->next].value);
}

int main(void)
{
    static bench b;
    port_output out = {0};
    long end, step = 0;
    int refused;
    read_scenario(&b);
    plant_init(&b.p, &b.s);
    if ((refused = port_init()) != 0) {
        fprintf(stderr, "the controller refuses its parameters: %d\n", refused);
        return 3;
    }
    end = lround(b.s.duration / b.p.tick);
    for (long now = 0; now < end; now++) {
        double time = (double)now * b.p.tick;
        happen(&b, time);
        if (now % (long)b.s.ticks == 0)
            sample_interrupt(&b);
        if (time >= ((double)step - 1e-6) * b.s.sample_time) {
            step++;
            if (plant_chance(&b.p) >= b.s.skipped)
                out = control_interrupt(&b);
            record(&b, time, &out);
        }
        for (; b.taken < b.sent && b.late[b.taken % LATE].due <= b.p.now; b.taken++)
            plant_command(&b.p, &b.s, b.late[b.taken % LATE].voltage, b.late[b.taken % LATE].frequency);
        plant_tick(&b.p, &b.s);
    }
    free(b.events);
    return 0;
}
