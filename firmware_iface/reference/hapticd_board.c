/* hapticd_board.c - see hapticd_board.h.
 *
 * Order of actions: a due event happens at its time, also before an OUT that arrived at the same
 * time. At one instant an interval ends before the watchdog trips, and both precede the latch of an
 * IN, which therefore contains them. An OUT acts on receipt.
 *
 * Torque has one gate. `cut_torque` closes it, and every cause calls it at once: the watchdog, a
 * fault, the emergency stop, an amplifier that is not ready, an OUT without ENABLE. Only an OUT
 * with ENABLE opens it again (`obey`), so torque never returns by itself. The clamp is the last
 * step before the DAC.
 *
 * Limitations: an entry that interrupts another; a clock that stops; a service that comes later
 * than an interval (pairs are then lost and the loss is reported; the watchdog is as late).
 */
#include "hapticd_board.h"

#include <string.h>

#define HOLD_US 2000000u   /* damping is held after the watchdog tripped */
#define RELEASE_US 500000u /* and then released */
#define RELEASE_STEPS (RELEASE_US / HAPTICD_INTERVAL_US)
#define US_PER_MS 1000u
#define VENDOR_IN 0xC0
#define VENDOR_OUT 0x40
#define CRC_CHECK 0x29B1 /* over "123456789" */
#define KNOWN_FLAGS (HAPTICD_FLAG_ENABLE | HAPTICD_FLAG_FIFO_CLEAR | HAPTICD_FLAG_PERTURB)
#define FAULTS                                                                                     \
    (HAPTICD_STATUS_OVER_TEMPERATURE | HAPTICD_STATUS_AMPLIFIER_FAULT |                            \
     HAPTICD_STATUS_ENCODER_FAULT)

/* the compiler must not add padding to the frames */
typedef char out_has_its_size[sizeof(struct hapticd_out) == HAPTICD_OUT_BYTES ? 1 : -1];
typedef char in_has_its_size[sizeof(struct hapticd_in) == HAPTICD_IN_BYTES ? 1 : -1];
typedef char hello_has_its_size[sizeof(struct hapticd_hello) == HAPTICD_HELLO_BYTES ? 1 : -1];

static uint16_t crc16(const uint8_t *data, size_t size)
{
    uint16_t crc = HAPTICD_CRC_INITIAL;
    while (size--) {
        crc = (uint16_t)(crc ^ *data++ << 8);
        for (int bit = 0; bit < 8; bit++)
            crc = (uint16_t)(crc & 0x8000 ? crc << 1 ^ HAPTICD_CRC_POLYNOMIAL : crc << 1);
    }
    return crc;
}

/* Return whether `now` is at or after `due`; correct across the wrap of the clock. */
static bool reached(uint32_t now_us, uint32_t due_us)
{
    return (int32_t)(now_us - due_us) >= 0;
}

static uint32_t clock_us(const struct hapticd_board *board)
{
    return board->port->clock_us(board->port->device);
}

static bool able(const struct hapticd_board *board, uint16_t capability)
{
    return board->hello.capabilities & capability;
}

/* --- outputs ---------------------------------------------------------------------------------- */

static void cut_torque(struct hapticd_board *board, uint32_t now_us)
{
    const struct hapticd_port *port = board->port;
    port->set_torque(port->device, false, 0);
    port->set_perturbation(port->device, 0);
    hapticd_probe_silence(&board->probe, now_us);
    board->live = false;
}

static void push(struct hapticd_board *board, int16_t torque)
{
    const int16_t limit = board->config->torque_limit;
    int16_t clamped = torque;
    if (torque > limit)
        clamped = limit;
    if (torque < -limit)
        clamped = (int16_t)-limit;
    if (clamped != torque)
        board->events |= HAPTICD_STATUS_FORCE_CLAMPED;
    board->port->set_torque(board->port->device, true, clamped);
    board->live = true;
}

static void damp(struct hapticd_board *board, uint16_t count)
{
    board->damping = count;
    board->port->set_damping(board->port->device, count);
}

/* Return whether torque may act, by the last read of the inputs. */
static bool permitted(const struct hapticd_board *board)
{
    bool ready = board->inputs & HAPTICD_STATUS_AMPLIFIER_READY ||
                 !able(board, HAPTICD_CAPABILITY_AMPLIFIER_READY);
    return ready && !board->faults && !(board->inputs & HAPTICD_STATUS_EMERGENCY_STOP);
}

static void look_at_inputs(struct hapticd_board *board, uint32_t now_us)
{
    board->inputs = board->port->inputs(board->port->device);
    board->faults |= board->inputs & FAULTS;
    if (!permitted(board))
        cut_torque(board, now_us);
}

/* --- the watchdog: one alarm, for its time-out and then for each step of the release ---------- */

static void feed(struct hapticd_board *board, uint32_t now_us)
{
    board->alarm_us = now_us + board->hello.watchdog_ms * US_PER_MS;
    board->alarm_set = true;
}

static void trip(struct hapticd_board *board)
{
    board->tripped = true;
    cut_torque(board, board->alarm_us);
    board->probe.playing = false;
    hapticd_probe_clear(&board->probe);
    board->held_damping = board->damping;
    board->release_us = board->alarm_us + HOLD_US;
    board->alarm_us = board->release_us;
}

/* Rounded up, so that no step is taken before its time. */
static void release_step(struct hapticd_board *board)
{
    uint32_t done = (board->alarm_us - board->release_us) / HAPTICD_INTERVAL_US;
    uint32_t left = board->held_damping * (RELEASE_STEPS - done) + RELEASE_STEPS - 1;
    damp(board, (uint16_t)(left / RELEASE_STEPS));
    board->alarm_us += HAPTICD_INTERVAL_US;
    board->alarm_set = done < RELEASE_STEPS;
}

/* --- the 4 kHz clock -------------------------------------------------------------------------- */

static void end_interval(struct hapticd_board *board, uint32_t now_us)
{
    const struct hapticd_port *port = board->port;
    struct hapticd_probe *probe = &board->probe;
    int16_t pair[2] = {probe->mean, 0};
    port->measure_pair(port->device, pair);
    board->events |= hapticd_probe_end_interval(probe, pair, board->live);
    if (now_us - probe->start_us >= HAPTICD_INTERVAL_US)
        board->events |=
            hapticd_probe_miss(probe, (now_us - probe->start_us) / HAPTICD_INTERVAL_US);
    port->set_perturbation(port->device, probe->sample);
    /* an age at its maximum stays there, however often the clock wraps */
    if (now_us - board->torque_since_us > HAPTICD_AGE_MAX_US)
        board->torque_since_us = now_us - HAPTICD_AGE_MAX_US;
    hapticd_events_grow_old(&board->pins, now_us);
}

/* --- event pins ------------------------------------------------------------------------------- */

static void look_at_pins(struct hapticd_board *board, uint32_t now_us)
{
    if (able(board, HAPTICD_CAPABILITY_EVENT))
        hapticd_events_look(&board->pins, board->port->event_code(board->port->device), now_us);
}

/* --- IN --------------------------------------------------------------------------------------- */

static uint16_t levels(const struct hapticd_board *board)
{
    uint16_t status = board->inputs & HAPTICD_STATUS_EMERGENCY_STOP;
    if (able(board, HAPTICD_CAPABILITY_AMPLIFIER_READY))
        status |= board->inputs & HAPTICD_STATUS_AMPLIFIER_READY;
    if (able(board, HAPTICD_CAPABILITY_SIMULATED))
        status |= HAPTICD_STATUS_SIMULATED;
    if (board->live)
        status |= HAPTICD_STATUS_ENABLED;
    if (board->tripped)
        status |= HAPTICD_STATUS_WATCHDOG;
    return status | board->faults;
}

/* The index mark of this frame, relative to its own encoder count. A mark beyond the range of 16
 * bits is omitted, because its value would be wrong. */
static int16_t index_offset(struct hapticd_board *board, const struct hapticd_sensors *sensors)
{
    if (sensors->index_passed && able(board, HAPTICD_CAPABILITY_INDEX)) {
        board->events |= HAPTICD_STATUS_INDEX;
        board->index_count = sensors->index_count;
    }
    if (!(board->events & HAPTICD_STATUS_INDEX))
        return 0;
    int32_t offset = (int32_t)((uint32_t)sensors->encoder - (uint32_t)board->index_count);
    if (offset >= INT16_MIN && offset <= INT16_MAX)
        return (int16_t)offset;
    board->events &= (uint16_t)~HAPTICD_STATUS_INDEX;
    return 0;
}

static uint8_t copy_pairs(struct hapticd_board *board)
{
    const struct hapticd_probe *probe = &board->probe;
    uint32_t count = hapticd_probe_waiting(probe);
    if (!able(board, HAPTICD_CAPABILITY_PROBE)) {
        board->pairs_end = probe->index;
        return 0;
    }
    if (count > HAPTICD_PAIR_MAX)
        count = HAPTICD_PAIR_MAX;
    for (uint32_t i = 0; i < count; i++) {
        const int16_t *pair = probe->pair[(probe->first_index + i) % HAPTICD_PAIRS];
        board->frame.pair[i][0] = pair[0];
        board->frame.pair[i][1] = pair[1];
    }
    board->pairs_end = probe->first_index + count;
    return (uint8_t)count;
}

static void drop_latch(struct hapticd_board *board)
{
    board->latch_oldest = (uint8_t)((board->latch_oldest + 1) % HAPTICD_LATCHES);
    board->latches--;
}

/* All values of the frame are of this instant. */
static void latch(struct hapticd_board *board)
{
    struct hapticd_in *frame = &board->frame;
    struct hapticd_sensors sensors = {0};
    uint32_t now_us = clock_us(board);
    uint32_t age_us = now_us - board->torque_since_us;
    board->port->sense(board->port->device, &sensors);
    drop_latch(board);
    look_at_inputs(board, now_us);
    if (board->waiting)
        board->events |= board->frame_events;

    memset(frame, 0, sizeof *frame);
    frame->seq = board->in_seq++;
    frame->echo = board->echo;
    frame->probe_count = copy_pairs(board);
    frame->index_offset = index_offset(board, &sensors);
    frame->status = board->events | levels(board);
    frame->board_time_us = now_us - board->origin_us;
    frame->encoder = sensors.encoder;
    frame->current = sensors.current;
    frame->voltage = sensors.voltage;
    frame->emf_velocity = sensors.emf_velocity;
    if (able(board, HAPTICD_CAPABILITY_TEMPERATURE))
        frame->temperature = sensors.temperature;
    frame->fifo_level = board->probe.level;
    frame->life = board->life;
    frame->probe_index = board->probe.first_index;
    frame->torque_age_us = (uint16_t)(age_us < HAPTICD_AGE_MAX_US ? age_us : HAPTICD_AGE_MAX_US);
    frame->damping_effect = board->damping;
    frame->torque_seq = board->torque_seq;
    if (able(board, HAPTICD_CAPABILITY_EVENT))
        hapticd_events_show(&board->pins, frame, now_us);
    frame->crc = crc16((const uint8_t *)frame, sizeof *frame - sizeof frame->crc);

    board->frame_events = board->events;
    board->events = 0;
    board->waiting = true;
    board->port->send(board->port->device, frame);
}

void hapticd_board_taken(struct hapticd_board *board)
{
    if (!board->waiting)
        return;
    board->waiting = false;
    hapticd_probe_forget(&board->probe, board->pairs_end);
    hapticd_events_taken(&board->pins, board->frame.event_seq);
}

/* In the order of their OUTs, also if the phase was shortened in between. */
static void schedule_latch(struct hapticd_board *board, uint32_t now_us)
{
    uint32_t due_us = now_us + board->phase_us;
    uint8_t newest = (uint8_t)((board->latch_oldest + board->latches - 1) % HAPTICD_LATCHES);
    if (board->latches && reached(board->latch_us[newest], due_us))
        due_us = board->latch_us[newest];
    if (board->latches == HAPTICD_LATCHES)
        drop_latch(board);
    board->latch_us[(board->latch_oldest + board->latches) % HAPTICD_LATCHES] = due_us;
    board->latches++;
}

/* --- due actions ------------------------------------------------------------------------------ */

/* Return whether the alarm precedes the end of the running interval; at equal times the interval is
 * first. */
static bool alarm_first(const struct hapticd_board *board)
{
    return board->alarm_set &&
           !reached(board->alarm_us, board->probe.start_us + HAPTICD_INTERVAL_US);
}

static uint32_t next_event_us(const struct hapticd_board *board)
{
    return alarm_first(board) ? board->alarm_us : board->probe.start_us + HAPTICD_INTERVAL_US;
}

/* INs are latched last: their values are of now, after all due actions. */
void hapticd_board_service(struct hapticd_board *board)
{
    uint32_t now_us = clock_us(board);
    if (!board->fit)
        return;
    look_at_pins(board, now_us);
    while (reached(now_us, next_event_us(board))) {
        if (!alarm_first(board))
            end_interval(board, now_us);
        else if (board->tripped)
            release_step(board);
        else
            trip(board);
    }
    while (board->latches && reached(now_us, board->latch_us[board->latch_oldest]))
        latch(board);
    look_at_inputs(board, now_us);
}

uint32_t hapticd_board_wait_us(const struct hapticd_board *board)
{
    uint32_t now_us = clock_us(board);
    uint32_t due_us = next_event_us(board);
    if (board->latches && !reached(board->latch_us[board->latch_oldest], due_us))
        due_us = board->latch_us[board->latch_oldest];
    return reached(now_us, due_us) ? 0 : due_us - now_us;
}

/* --- OUT -------------------------------------------------------------------------------------- */

static bool decoded(struct hapticd_out *out, const uint8_t *data, size_t size)
{
    static const uint8_t zeros[sizeof out->reserved];
    if (size != sizeof *out)
        return false;
    memcpy(out, data, sizeof *out);
    return out->crc == crc16(data, sizeof *out - sizeof out->crc) &&
           out->axis < HAPTICD_AXIS_COUNT && out->probe_count <= HAPTICD_PROBE_MAX &&
           !(out->flags & ~KNOWN_FLAGS) && !out->reserved0 &&
           !memcmp(out->reserved, zeros, sizeof zeros);
}

static void obey(struct hapticd_board *board, const struct hapticd_out *out, uint32_t now_us)
{
    int16_t samples[HAPTICD_PROBE_MAX];
    bool enable = out->flags & HAPTICD_FLAG_ENABLE;
    if (board->tripped && enable)
        return; /* answered and echoed; nothing in it acts */
    if (board->tripped)
        hapticd_events_forget(&board->pins);
    board->tripped = false;
    feed(board, now_us);
    damp(board, out->damping);
    if (able(board, HAPTICD_CAPABILITY_RESISTANCE))
        board->port->set_resistance(board->port->device, out->resistance);
    if (enable && permitted(board))
        push(board, out->torque);
    else
        cut_torque(board, now_us);
    board->torque_seq = (uint8_t)out->seq;
    board->torque_since_us = clock_us(board);
    board->probe.playing = out->flags & HAPTICD_FLAG_PERTURB;
    if (out->flags & HAPTICD_FLAG_FIFO_CLEAR)
        hapticd_probe_clear(&board->probe);
    memcpy(samples, out->perturbation, sizeof samples);
    board->events |= hapticd_probe_queue(&board->probe, samples, out->probe_count);
}

bool hapticd_board_out(struct hapticd_board *board, const uint8_t *data, size_t size)
{
    struct hapticd_out out;
    uint32_t now_us;
    if (!board->fit)
        return false;
    hapticd_board_service(board);
    now_us = clock_us(board);
    if (!decoded(&out, data, size)) {
        board->events |= HAPTICD_STATUS_BAD_FRAME;
        return false;
    }
    if (board->heard && out.seq != board->next_seq)
        board->events |= HAPTICD_STATUS_SEQ_GAP;
    board->heard = true;
    board->next_seq = (uint16_t)(out.seq + 1);
    board->echo = out.seq;
    schedule_latch(board, now_us);
    obey(board, &out, now_us);
    return true;
}

/* --- endpoint 0 ------------------------------------------------------------------------------- */

int hapticd_board_control(struct hapticd_board *board, uint8_t request_type, uint8_t request,
                          uint16_t value, uint16_t index, uint16_t length, uint8_t *reply)
{
    if (!board->fit || index)
        return HAPTICD_STALL;
    if (request_type == VENDOR_IN && request == HAPTICD_REQUEST_HELLO && !value) {
        size_t size = length < sizeof board->hello ? length : sizeof board->hello;
        memcpy(reply, &board->hello, size);
        return (int)size;
    }
    if (request_type == VENDOR_OUT && request == HAPTICD_REQUEST_CLEAR_FAULT && !value) {
        board->faults = board->port->inputs(board->port->device) & FAULTS;
        return 0;
    }
    if (request_type == VENDOR_OUT && request == HAPTICD_REQUEST_SAMPLE_PHASE &&
        able(board, HAPTICD_CAPABILITY_SAMPLE_PHASE) && value <= board->config->period_us) {
        board->phase_us = value;
        return 0;
    }
    return HAPTICD_STALL;
}

/* --- boot ------------------------------------------------------------------------------------- */

/* Detect a wrong compiler, processor or table. The only function with floating point. */
static bool self_test(const struct hapticd_config *config)
{
    const struct hapticd_hello *hello = &config->hello;
    const uint16_t word = 1;
    uint8_t low_byte;
    float limit_n = hello->force_full_scale_n * config->torque_limit / INT16_MAX;
    memcpy(&low_byte, &word, sizeof low_byte);
    return low_byte == 1 && crc16((const uint8_t *)"123456789", 9) == CRC_CHECK &&
           hello->watchdog_ms && config->torque_limit > 0 && hello->force_full_scale_n > 0 &&
           limit_n <= hello->force_limit_n * 1.0001f && config->phase_us <= config->period_us;
}

static void fill_hello(struct hapticd_board *board)
{
    board->hello = board->config->hello;
    for (unsigned i = 0; i < sizeof board->hello.protocol_hash; i++)
        board->hello.protocol_hash[i] = (uint8_t)(HAPTICD_PROTOCOL_HASH >> (56 - 8 * i));
}

bool hapticd_board_boot(struct hapticd_board *board, const struct hapticd_config *config,
                        const struct hapticd_port *port, uint8_t life)
{
    uint32_t now_us;
    memset(board, 0, sizeof *board);
    board->port = port;
    board->config = config;
    fill_hello(board);
    now_us = clock_us(board);
    hapticd_probe_start(&board->probe, now_us);
    cut_torque(board, now_us);
    damp(board, 0);
    port->set_resistance(port->device, 0);
    hapticd_events_start(&board->pins, 0, now_us);
    if (able(board, HAPTICD_CAPABILITY_EVENT))
        hapticd_events_start(&board->pins, port->event_code(port->device), now_us);
    board->origin_us = now_us;
    board->torque_since_us = now_us;
    board->phase_us = config->phase_us;
    board->life = life;
    board->fit = self_test(config);
    feed(board, now_us);
    look_at_inputs(board, now_us);
    return board->fit;
}
