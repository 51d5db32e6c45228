/* The yardstick in C: all work of the servo's tick between two transfers, with the same frames, stages and record.
 *
 * Check the IN frame (CRC, axis, count, sequence, echo, board time), read commands, stop and heartbeat, K-B-M with both
 * filters, wall and ends, limit, count, energy ledger, OUT frame with CRC, the whole record, head and heartbeat.
 */
#include <math.h>
#include <stdint.h>
#include <string.h>
#include <time.h>

#include "hapticd_wire.h"
#include "record.h" /* generated from the table of hapticd/mailbox/layout.py for the compilation */

enum { SLOTS = 8192, FLAG_CLAMPED = 32 };

/* state of the servo between ticks; filled by tick_worker.py in this order */
struct servo {
    double law[6], environment[12], coefficients[10];
    double work, excess, newer, older, oldest, elastic, velocity;
    double m_per_count, counts_per_n, n_per_count, resistance, resistance_per_count, kept, periods_per_us, damping_slope, slope[4];
    int64_t tick, board_us, period_us;
    uint16_t expected, sent, out_flags, damping;
    int64_t sampled[256], sent_at[256]; /* by the low byte of the sequence number of an OUT */
    uint8_t plan[sizeof(((struct record *)0)->plan)];
};

const int record_bytes = sizeof(struct record);
const int servo_bytes = sizeof(struct servo);
static uint16_t table[256];
static struct hapticd_out wire;
static volatile uint64_t words[256]; /* mailbox: stop, command head and tail, beats, ring head */

static int64_t now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

static uint16_t crc16(const void *data, int bytes)
{
    const uint8_t *from = data;
    uint16_t crc = HAPTICD_CRC_INITIAL;
    while (bytes--)
        crc = (uint16_t)(crc << 8) ^ table[(crc >> 8) ^ *from++];
    return crc;
}

static void make_table(void)
{
    for (int i = 0; i < 256; i++) {
        uint16_t crc = (uint16_t)(i << 8);
        for (int bit = 0; bit < 8; bit++)
            crc = (uint16_t)(crc << 1) ^ (crc & 0x8000 ? HAPTICD_CRC_POLYNOMIAL : 0);
        table[i] = crc;
    }
}

static int accept(struct servo *s, const struct hapticd_in *in)
{
    int64_t passed = (int64_t)in->board_time_us - (s->board_us & 0xFFFFFFFF);
    if (in->crc != crc16(in, HAPTICD_IN_BYTES - 2) || in->axis >= HAPTICD_AXIS_COUNT || in->probe_count > HAPTICD_PAIR_MAX)
        return 0;
    if (in->seq != s->expected || in->echo != s->sent || 2 * passed < s->period_us || 2 * passed > 3 * s->period_us)
        return 0;
    s->expected++;
    s->board_us += passed;
    return 1;
}

static uint32_t law(struct servo *s, double x, struct record *r)
{
    const double *e = s->environment, *c = s->coefficients;
    double *l = s->law, d = x - l[0], dd = d - l[1], v = c[0] * d + l[2], a = c[5] * dd + l[4];
    l[0] = x;
    l[1] = d;
    l[2] = c[1] * d - c[3] * v + l[3];
    l[3] = c[2] * d - c[4] * v;
    l[4] = c[6] * dd - c[8] * a + l[5];
    l[5] = c[7] * dd - c[9] * a;
    r->position_m = x, r->velocity_m_per_s = v, r->acceleration_m_per_s2 = a;
    r->stiffness_force_n = -e[0] * x, r->virtual_damping_force_n = -e[1] * v, r->mass_force_n = -e[2] * a, r->field_force_n = 0.0;
    if (e[8] != 0.0 && (x - e[7]) * e[8] > 0.0) {
        double push = e[5] * (x - e[7]) * e[8] + e[6] * v * e[8];
        r->field_force_n = push > 0.0 ? -push * e[8] : 0.0;
    }
    if (!(e[9] <= x && x <= e[10]))
        r->field_force_n -= e[11] * (x < e[9] ? x - e[9] : x - e[10]);
    double total = e[3] + r->stiffness_force_n + r->virtual_damping_force_n + r->mass_force_n + r->field_force_n;
    r->force_n = !(total <= e[4]) ? e[4] : total < -e[4] ? -e[4] : total;
    return r->force_n != total ? FLAG_CLAMPED : 0;
}

static void book(struct servo *s, struct record *r, int damping)
{
    double delay = r->delay_us * s->periods_per_us, d = s->law[1], limit = s->environment[4], v = r->velocity_m_per_s;
    double elastic = r->stiffness_force_n + r->field_force_n;
    elastic = elastic > limit ? limit : elastic < -limit ? -limit : elastic;
    double done = delay < 1.0 ? d * (s->newer + delay * (s->older - s->newer))
                              : d * (s->older + (delay < 2.0 ? delay - 1.0 : 1.0) * (s->oldest - s->older));
    double stored = 0.5 * s->environment[2] * (v * v - s->velocity * s->velocity) - 0.5 * d * (elastic + s->elastic);
    s->excess = s->kept * s->excess + done + stored - (s->resistance + s->resistance_per_count * damping) * d * d;
    s->excess = s->excess < 0.0 ? 0.0 : s->excess;
    r->work_j = s->work += done, r->excess_j = s->excess;
    s->oldest = s->older, s->older = s->newer, s->newer = r->force_n, s->elastic = elastic, s->velocity = v;
}

/* `count` ticks over as many IN frames into `ring`; 0, or the number of the first invalid frame, counted from 1 */
int reference_ticks(struct servo *s, const uint8_t *frames, uint8_t *ring, int count)
{
    int32_t publish = 0, least = 1 << 30, most = 0, spread = 0;
    if (!table[1])
        make_table();
    for (int i = 0; i < count; i++) {
        const struct hapticd_in *in = (const void *)(frames + i * HAPTICD_IN_BYTES);
        struct record *r = (void *)(ring + s->tick % SLOTS * sizeof *r);
        int64_t start = now_ns();
        if (!accept(s, in))
            return i + 1;
        int64_t got = now_ns();
        if (words[0] || words[1] != words[2] || start < (int64_t)words[3])
            return i + 1;
        r->delay_us = (int32_t)(s->board_us - in->torque_age_us - s->sampled[in->torque_seq]);
        r->frame_age_us = (int32_t)((got - s->sent_at[in->echo & 255]) / 1000 - in->torque_age_us);
        least = r->delay_us < least ? r->delay_us : least;
        most = r->delay_us > most ? r->delay_us : most;
        uint32_t flags = law(s, in->encoder * s->m_per_count, r);
        int torque = (int)floor(r->force_n * s->counts_per_n + 0.5);
        torque = torque < -32768 ? -32768 : torque > 32767 ? 32767 : torque;
        r->force_n = torque * s->n_per_count;
        book(s, r, in->damping_effect);
        int64_t stepped = now_ns();
        wire.seq = ++s->sent, wire.flags = s->out_flags, wire.torque = torque, wire.damping = s->damping;
        s->sampled[s->sent & 255] = s->board_us;
        s->sent_at[s->sent & 255] = stepped;
        wire.crc = crc16(&wire, HAPTICD_OUT_BYTES - 2);
        int64_t sent = now_ns();
        r->tick = r->tail = r->slot = s->tick, r->time_ns = start, r->board_us = s->board_us;
        memcpy(r->plan, s->plan, sizeof r->plan);
        r->flags = flags, r->status = in->status;
        r->winding_c = in->temperature * s->slope[0], r->current_a = in->current * s->slope[1];
        r->voltage_v = in->voltage * s->slope[2], r->emf_velocity_m_per_s = in->emf_velocity * s->slope[3];
        r->wake_ns = 0, r->read_ns = got - start, r->step_ns = stepped - got, r->write_ns = sent - stepped;
        r->publish_ns = publish, r->lost_slots = 0, r->late_cause = 0, r->late_ns = 0;
        r->delay_spread_us = spread, r->active_damping_effect_ns_per_m = in->damping_effect * s->damping_slope;
        if (!(s->tick & 255)) {
            spread = most > least ? most - least : 0;
            least = 1 << 30, most = 0;
        }
        memcpy(r->in_frame, in, HAPTICD_IN_BYTES);
        memcpy(r->out_frame, &wire, HAPTICD_OUT_BYTES);
        __atomic_store_n(&words[4], ++s->tick, __ATOMIC_RELEASE);
        words[5] = start;
        publish = (int32_t)(now_ns() - sent);
    }
    return 0;
}
