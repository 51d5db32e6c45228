/* hapticd_probe.h - the 4 kHz part of the reference firmware: perturbation FIFO and measured pairs.
 *
 * Every 250 us of the board's clock one interval ends. It yields a pair: the mean perturbation
 * torque output in it, and the mean velocity. The next interval plays the next sample of the FIFO.
 * Pairs are queued, PAIRS at most, until the host has read the frame with them. Beyond PAIRS the
 * oldest is lost, and `first_index` reveals it.
 *
 * This module does not access hardware: the caller writes `sample` to the DAC and passes the pair.
 */
#ifndef HAPTICD_PROBE_H
#define HAPTICD_PROBE_H

#include <stdbool.h>
#include <stdint.h>

#include "hapticd_wire.h"

#define HAPTICD_INTERVAL_US (1000000 / HAPTICD_PROBE_RATE_HZ)
#define HAPTICD_PAIRS 64 /* queued for the host; 16 periods at 1 kHz */

struct hapticd_probe {
    int16_t fifo[HAPTICD_FIFO_DEPTH]; /* ring: `level` samples from `oldest` on */
    uint8_t oldest;
    uint8_t level;
    int16_t pair[HAPTICD_PAIRS][2]; /* ring: interval i is at i % HAPTICD_PAIRS */
    uint32_t first_index;           /* interval of the oldest queued pair; wraps */
    uint32_t index;                 /* the running interval; wraps */
    uint32_t start_us;              /* its start, by the port's clock */
    int16_t sample;                 /* count being output */
    int16_t mean;                   /* of the running interval, unless it is silenced */
    bool playing;                   /* the host set PERTURB */
};

/* Clear all state; interval 0 starts now. */
void hapticd_probe_start(struct hapticd_probe *probe, uint32_t now_us);

/* Append samples. Those that do not fit are dropped: HAPTICD_STATUS_FIFO_OVERFLOW, else 0. */
uint16_t hapticd_probe_queue(struct hapticd_probe *probe, const int16_t *samples, uint8_t count);

void hapticd_probe_clear(struct hapticd_probe *probe);

/* Stop the torque now, within an interval: its mean keeps the earlier output. */
void hapticd_probe_silence(struct hapticd_probe *probe, uint32_t now_us);

/* End the running interval with its pair; `live`: torque may act. `sample` is then the output of
 * the next interval. Returns the status events that this raised. */
uint16_t hapticd_probe_end_interval(struct hapticd_probe *probe, const int16_t pair[2], bool live);

/* `count` intervals passed without service. Their pairs cannot be separated: they are dropped with
 * all earlier ones, so that the pairs of a frame stay consecutive. */
uint16_t hapticd_probe_miss(struct hapticd_probe *probe, uint32_t count);

/* Return the number of queued pairs. */
uint32_t hapticd_probe_waiting(const struct hapticd_probe *probe);

/* The host has the pairs before interval `index`. */
void hapticd_probe_forget(struct hapticd_probe *probe, uint32_t index);

#endif
