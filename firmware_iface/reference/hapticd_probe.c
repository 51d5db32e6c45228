/* hapticd_probe.c - see hapticd_probe.h. Numbers of intervals wrap after 12.4 days; only their
 * differences are compared, as signed numbers. */
#include "hapticd_probe.h"

#include <string.h>

void hapticd_probe_start(struct hapticd_probe *probe, uint32_t now_us)
{
    memset(probe, 0, sizeof *probe);
    probe->start_us = now_us;
}

uint16_t hapticd_probe_queue(struct hapticd_probe *probe, const int16_t *samples, uint8_t count)
{
    for (uint8_t i = 0; i < count; i++) {
        if (probe->level == HAPTICD_FIFO_DEPTH)
            return HAPTICD_STATUS_FIFO_OVERFLOW;
        probe->fifo[(probe->oldest + probe->level) % HAPTICD_FIFO_DEPTH] = samples[i];
        probe->level++;
    }
    return 0;
}

void hapticd_probe_clear(struct hapticd_probe *probe)
{
    probe->level = 0;
}

/* floor(sample * elapsed / 250 + 1/2), as the host rounds; C divides towards zero, so the floor of
 * a negative quotient needs a step down. */
static int16_t part_of(int16_t sample, uint32_t elapsed_us)
{
    const int32_t whole = 2 * HAPTICD_INTERVAL_US;
    int32_t twice = 2 * (int32_t)sample * (int32_t)elapsed_us + HAPTICD_INTERVAL_US;
    int32_t quotient = twice / whole;
    return (int16_t)(twice % whole < 0 ? quotient - 1 : quotient);
}

void hapticd_probe_silence(struct hapticd_probe *probe, uint32_t now_us)
{
    uint32_t elapsed_us = now_us - probe->start_us;
    if (!probe->sample)
        return;
    if (elapsed_us > HAPTICD_INTERVAL_US)
        elapsed_us = HAPTICD_INTERVAL_US;
    probe->mean = part_of(probe->sample, elapsed_us);
    probe->sample = 0;
}

/* A sample that may not act is consumed too: the host relies on the FIFO's rate. */
static int16_t next_sample(struct hapticd_probe *probe, bool live)
{
    int16_t sample = probe->fifo[probe->oldest];
    probe->oldest = (uint8_t)((probe->oldest + 1) % HAPTICD_FIFO_DEPTH);
    probe->level--;
    return live ? sample : 0;
}

uint16_t hapticd_probe_end_interval(struct hapticd_probe *probe, const int16_t pair[2], bool live)
{
    uint16_t events = 0;
    memcpy(probe->pair[probe->index % HAPTICD_PAIRS], pair, sizeof probe->pair[0]);
    probe->index++;
    probe->start_us += HAPTICD_INTERVAL_US;
    if (hapticd_probe_waiting(probe) > HAPTICD_PAIRS) {
        probe->first_index++;
        events |= HAPTICD_STATUS_PROBE_OVERFLOW;
    }
    probe->sample = 0;
    if (probe->playing && probe->level)
        probe->sample = next_sample(probe, live);
    else if (probe->playing)
        events |= HAPTICD_STATUS_FIFO_UNDERRUN;
    probe->mean = probe->sample;
    return events;
}

uint16_t hapticd_probe_miss(struct hapticd_probe *probe, uint32_t count)
{
    probe->index += count;
    probe->start_us += count * HAPTICD_INTERVAL_US;
    probe->first_index = probe->index;
    return HAPTICD_STATUS_PROBE_OVERFLOW;
}

uint32_t hapticd_probe_waiting(const struct hapticd_probe *probe)
{
    return probe->index - probe->first_index;
}

void hapticd_probe_forget(struct hapticd_probe *probe, uint32_t index)
{
    if ((int32_t)(index - probe->first_index) > 0)
        probe->first_index = index;
}
