/* Drives the reference firmware at random and checks the promises of a board, for any behaviour of the host, the
 * hardware and the clock: firmware_fuzz STEPS SEED. It uses only inputs, outputs and frames, not the internals of the
 * firmware. Unlike the simulated board, its hardware contradicts itself (a stop pressed while the amplifier is ready),
 * is late, passes index marks and may be configured wrongly. Exits with status 1 at the first broken promise, and
 * prints its counts. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "hapticd_board.h"

#define WATCHDOG_US 20000
#define HOLD_US 2000000
#define RELEASE_US 500000
#define CAUSES                                                                                     \
    (HAPTICD_STATUS_OVER_TEMPERATURE | HAPTICD_STATUS_AMPLIFIER_FAULT |                            \
     HAPTICD_STATUS_ENCODER_FAULT)

static struct {
    uint64_t now_us; /* never wraps; the port's clock is its low half */
    uint16_t inputs;
    struct hapticd_sensors sensors;
    uint16_t event_code;
    bool authority; /* state of the outputs */
    int16_t torque, perturbation, resistance;
    uint16_t damping;
    struct hapticd_in frame; /* the newest */
    bool sent;
} world;

static struct { /* promised state */
    uint64_t born_us, fed_us, measured_us;
    bool asked, tripped;
    uint16_t damping;
    int16_t resistance;
    uint16_t latched; /* faults */
    uint16_t next_in, echo;
    uint32_t next_pair;
    int32_t mark;
    bool passed;        /* the index mark, since the last IN */
    bool bad, bad_said; /* an OUT was refused since the last IN; the newest IN reports it */
    unsigned owed; /* INs */
    struct {       /* state of the event pins, by the number of the event */
        uint16_t code;
        uint64_t at_us;
        unsigned taken; /* frames that reported it */
    } event[256];
    bool born;             /* the pins have been read */
    uint8_t newest, shown; /* numbers of events */
    bool may_skip;         /* the oldest were lost, or no host was connected */
} host;

static struct hapticd_board board;
static struct hapticd_config config;
static uint64_t random_state;
static unsigned long met_frames, met_refused, met_trips, met_boots, met_pairs, met_events;

static uint32_t draw(uint32_t below) /* xorshift64 */
{
    random_state ^= random_state << 13;
    random_state ^= random_state >> 7;
    random_state ^= random_state << 17;
    return (uint32_t)(random_state >> 32) % below;
}

static void promise(bool kept, const char *what)
{
    if (kept)
        return;
    fprintf(stderr, "broken at %llu us: %s\n", (unsigned long long)world.now_us, what);
    exit(1);
}

static bool able(uint16_t capability)
{
    return config.hello.capabilities & capability;
}

/* --- the hardware ------------------------------------------------------------------------------- */

static uint32_t clock_us(void *device) { (void)device; return (uint32_t)world.now_us; }
static uint16_t inputs(void *device) { (void)device; return world.inputs; }
static void set_perturbation(void *device, int16_t count) { (void)device; world.perturbation = count; }
static void set_damping(void *device, uint16_t count) { (void)device; world.damping = count; }
static void set_resistance(void *device, int16_t count) { (void)device; world.resistance = count; }

static void sense(void *device, struct hapticd_sensors *sensors)
{
    (void)device;
    *sensors = world.sensors;
    host.passed = sensors->index_passed && able(HAPTICD_CAPABILITY_INDEX);
    if (host.passed)
        host.mark = sensors->index_count;
    world.sensors.index_passed = false;
}

static uint16_t event_code(void *device)
{
    (void)device;
    promise(able(HAPTICD_CAPABILITY_EVENT), "pins that are not there are not read");
    if (host.born && world.event_code == host.event[host.newest].code)
        return world.event_code;
    host.newest = (uint8_t)(host.newest + host.born);
    host.event[host.newest].code = world.event_code;
    host.event[host.newest].at_us = host.born ? world.now_us : 0;
    host.event[host.newest].taken = 0;
    host.may_skip |= (uint8_t)(host.newest - host.shown) >= HAPTICD_EVENT_DEPTH - 1;
    host.born = true;
    return world.event_code;
}

/* The event that a frame shows is the one after that of the frame before, or the same. */
static void check_event(const struct hapticd_in *frame)
{
    uint8_t step = (uint8_t)(frame->event_seq - host.shown);
    uint64_t age_us = world.now_us - host.event[frame->event_seq].at_us;
    if (!able(HAPTICD_CAPABILITY_EVENT)) {
        promise(!frame->event_seq && !frame->event_code && !frame->event_age_us, "no event pins");
        return;
    }
    promise((uint8_t)(host.newest - frame->event_seq) < HAPTICD_EVENT_DEPTH, "no event of before");
    promise(frame->event_code == host.event[frame->event_seq].code, "each event has its code");
    promise(frame->event_age_us == (age_us < 65535 ? age_us : 65535), "each event has its time");
    promise(step <= 1 || host.may_skip, "no event is left out");
    promise(!step || host.may_skip || host.event[host.shown].taken >= HAPTICD_EVENT_FRAMES,
            "each event is in two frames that were taken");
    if (frame->event_seq == host.newest)
        host.may_skip = false;
    met_events += step;
    host.shown = frame->event_seq;
}

static void measure_pair(void *device, int16_t pair[2])
{
    (void)device;
    promise(world.now_us > host.measured_us, "no pair is a mean over no time");
    host.measured_us = world.now_us;
    pair[1] = (int16_t)((world.now_us - host.born_us) / HAPTICD_INTERVAL_US - 1);
}

static void set_torque(void *device, bool authority, int16_t count)
{
    (void)device;
    world.authority = authority;
    world.torque = count;
}

static void send(void *device, const struct hapticd_in *frame)
{
    (void)device;
    promise(host.owed > 0, "one accepted OUT latches one IN");
    host.owed--;
    promise(frame->seq == host.next_in++, "seq counts every latched frame");
    promise(frame->echo == host.echo, "echo is the last OUT that was accepted");
    promise(!(frame->status & HAPTICD_STATUS_ENABLED) == !world.authority, "ENABLED is what acts");
    promise(frame->damping_effect == world.damping, "damping_effect is what acts");
    promise(frame->probe_count <= HAPTICD_PAIR_MAX, "at most 5 pairs");
    promise(frame->fifo_level <= HAPTICD_FIFO_DEPTH, "at most 16 samples");
    promise(frame->board_time_us == (uint32_t)(world.now_us - host.born_us), "time of the latch");
    if (frame->probe_count < HAPTICD_PAIR_MAX && able(HAPTICD_CAPABILITY_PROBE))
        promise(frame->probe_index + frame->probe_count ==
                    (uint32_t)((world.now_us - host.born_us) / HAPTICD_INTERVAL_US),
                "intervals are numbered by the clock");
    promise(frame->index_offset == 0 || frame->status & HAPTICD_STATUS_INDEX, "INDEX or 0");
    if (frame->status & HAPTICD_STATUS_INDEX)
        promise((uint32_t)frame->encoder - (uint32_t)host.mark ==
                    (uint32_t)(int32_t)frame->index_offset,
                "index_offset counts from the mark");
    int32_t reach = (int32_t)((uint32_t)frame->encoder - (uint32_t)host.mark);
    if (host.passed && abs(reach / 2) < INT16_MAX / 2)
        promise(frame->status & HAPTICD_STATUS_INDEX, "a mark that was passed is said");
    promise(!((frame->status ^ world.inputs) & HAPTICD_STATUS_EMERGENCY_STOP), "stop is a level");
    host.bad_said = host.bad || (world.sent && host.bad_said);
    promise(!(frame->status & HAPTICD_STATUS_BAD_FRAME) == !host.bad_said, "BAD_FRAME once");
    host.bad = false;
    check_event(frame);
    world.frame = *frame;
    world.sent = true;
}

static const struct hapticd_port port = {
    NULL,       clock_us,         inputs,      sense,          measure_pair,
    set_torque, set_perturbation, set_damping, set_resistance, send,
    event_code,
};

/* --- promises --------------------------------------------------------------------------------- */

static uint64_t since_fed(void)
{
    return world.now_us - host.fed_us;
}

/* Record the promised state, before or after a call of the firmware. */
static void notice(void)
{
    host.latched |= world.inputs & CAUSES;
    if (since_fed() >= WATCHDOG_US && !host.tripped) {
        host.tripped = true;
        met_trips++;
    }
}

/* Check the promises just after the firmware has read all inputs. */
static void judge(void)
{
    bool needs_ready = able(HAPTICD_CAPABILITY_AMPLIFIER_READY);
    notice();
    if (world.authority) {
        promise(host.asked, "no torque without ENABLE");
        promise(!host.tripped, "no torque after the watchdog");
        promise(!(world.inputs & HAPTICD_STATUS_EMERGENCY_STOP), "no torque while stopped");
        promise(!host.latched, "no torque with a latched fault");
        promise(!needs_ready || world.inputs & HAPTICD_STATUS_AMPLIFIER_READY, "nor unready");
    }
    promise(abs(world.torque) <= config.torque_limit, "torque is clamped");
    promise(world.authority || (!world.torque && !world.perturbation), "nothing without authority");
    promise(world.resistance == host.resistance, "the trim is what was commanded last");
    if (since_fed() < WATCHDOG_US + HOLD_US) {
        promise(world.damping == host.damping, "damping is as commanded, then held for 2 s");
    } else {
        int64_t left = WATCHDOG_US + HOLD_US + RELEASE_US - (int64_t)since_fed();
        int64_t step = host.damping / 2000 + 2; /* of 250 us, and two roundings */
        int64_t line = left > 0 ? host.damping * left / RELEASE_US : 0;
        promise(world.damping >= line, "damping is released no faster than in 0.5 s");
        promise(world.damping <= line + step, "damping is released within 0.5 s");
    }
}

static void serve(void)
{
    hapticd_board_service(&board);
    if (!board.fit)
        return;
    promise(hapticd_board_wait_us(&board) <= HAPTICD_INTERVAL_US, "asked again in 250 us");
    judge();
}

/* Advance the time; punctually, or with one service at its end, as late as `wait_us`. */
static void pass(uint32_t wait_us, bool punctual)
{
    uint64_t until_us = world.now_us + wait_us;
    while (punctual && board.fit && world.now_us + hapticd_board_wait_us(&board) < until_us) {
        world.now_us += hapticd_board_wait_us(&board);
        serve();
    }
    world.now_us = until_us;
    serve();
}

/* --- actions ---------------------------------------------------------------------------------- */

static void boot(void)
{
    memset(&host, 0, sizeof host);
    memset(&config, 0, sizeof config);
    config.hello.watchdog_ms = WATCHDOG_US / 1000;
    config.hello.force_full_scale_n = 8.0f;
    config.hello.force_limit_n = 6.0f;
    config.hello.capabilities = (uint16_t)(draw(4) ? 0x04FF : draw(0x10000));
    config.torque_limit = 24575;
    config.period_us = 1000;
    config.phase_us = 875;
    switch (draw(16)) {
    case 0: config.hello.watchdog_ms = 0; break;
    case 1: config.torque_limit = 24600; break;
    case 2: config.torque_limit = 0; break;
    case 3: config.hello.force_full_scale_n = 0.0f; break;
    case 4: config.phase_us = 1001; break;
    default: break;
    }
    bool right = config.hello.watchdog_ms && config.torque_limit == 24575 &&
                 config.hello.force_full_scale_n > 0.0f && config.phase_us == 875;
    host.fed_us = world.now_us;
    host.born_us = world.now_us;
    host.measured_us = world.now_us;
    promise(hapticd_board_boot(&board, &config, &port, (uint8_t)draw(256)) == right, "self-test");
    promise(!world.authority && !world.torque && !world.damping && !world.resistance, "nothing yet");
    world.sent = false;
    met_boots++;
}

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

static struct hapticd_out good(void)
{
    struct hapticd_out out = {0};
    out.seq = (uint16_t)(host.echo + (draw(20) ? 1 : draw(100)));
    out.flags = (uint8_t)(draw(4) ? HAPTICD_FLAG_ENABLE | HAPTICD_FLAG_PERTURB : draw(8));
    out.torque = (int16_t)draw(65536);
    out.damping = (uint16_t)draw(65536);
    out.resistance = (int16_t)draw(65536);
    out.probe_count = (uint8_t)draw(HAPTICD_PROBE_MAX + 1);
    for (unsigned i = 0; i < out.probe_count; i++)
        out.perturbation[i] = (int16_t)draw(65536);
    return out;
}

/* Change a frame into one that a board refuses. */
static void damage(uint8_t *data, size_t *size)
{
    static const uint8_t at[] = {2, 3, 10, 11, 24, 29};
    uint32_t way = draw(4);
    if (way == 0)
        *size = draw(HAPTICD_OUT_BYTES);
    if (way == 1)
        *size = HAPTICD_OUT_BYTES + 1 + draw(32);
    if (way == 2)
        data[draw(HAPTICD_OUT_BYTES)] ^= (uint8_t)(1u << draw(8));
    if (way == 3) {
        uint8_t place = at[draw(sizeof at)];
        data[place] = (uint8_t)(place == 3 ? 8u << draw(5) : 7 + draw(249));
        uint16_t crc = crc16(data, HAPTICD_OUT_BYTES - sizeof crc);
        memcpy(data + HAPTICD_OUT_BYTES - sizeof crc, &crc, sizeof crc);
    }
}

static void obeyed(const struct hapticd_out *out)
{
    host.echo = out->seq;
    host.owed += host.owed < HAPTICD_LATCHES;
    if (host.tripped && out->flags & HAPTICD_FLAG_ENABLE)
        return;
    host.may_skip |= host.tripped;
    host.tripped = false;
    host.fed_us = world.now_us;
    host.asked = out->flags & HAPTICD_FLAG_ENABLE;
    host.damping = out->damping;
    if (able(HAPTICD_CAPABILITY_RESISTANCE))
        host.resistance = out->resistance;
}

static void send_out(bool whole)
{
    uint8_t data[64] = {0};
    size_t size = HAPTICD_OUT_BYTES;
    struct hapticd_out out = good();
    out.crc = crc16((const uint8_t *)&out, sizeof out - sizeof out.crc);
    memcpy(data, &out, sizeof out);
    if (!whole)
        damage(data, &size);
    if (draw(2))
        serve();
    notice();
    /* exactly as long as the packet, so that the sanitizer detects every access beyond it */
    uint8_t *packet = malloc(size ? size : 1);
    if (!packet)
        exit(2);
    memcpy(packet, data, size);
    bool taken = hapticd_board_out(&board, packet, size);
    free(packet);
    promise(taken == (whole && board.fit), "whole frames are taken, others are not");
    met_frames++;
    met_refused += !taken;
    host.bad |= !taken;
    if (taken)
        obeyed(&out);
    if (board.fit)
        judge();
}

static void take(void)
{
    struct hapticd_in *frame = &world.frame;
    hapticd_board_taken(&board);
    if (!world.sent)
        return;
    world.sent = false;
    host.event[frame->event_seq].taken++;
    promise(frame->crc == crc16((const uint8_t *)frame, sizeof *frame - sizeof frame->crc), "CRC");
    if (!(frame->status & HAPTICD_STATUS_PROBE_OVERFLOW) && frame->probe_count)
        promise(frame->probe_index == host.next_pair, "every pair comes once, in order");
    for (uint32_t i = 0; i < frame->probe_count; i++)
        promise(frame->pair[i][1] == (int16_t)(frame->probe_index + i), "each pair of its interval");
    host.next_pair = frame->probe_index + frame->probe_count;
    met_pairs += frame->probe_count;
}

static void ask(void)
{
    uint8_t reply[HAPTICD_HELLO_BYTES];
    uint8_t type = draw(2) ? 0xC0 : 0x40;
    uint16_t index = draw(8) == 0;
    uint16_t value = (uint16_t)(draw(2) ? 0 : draw(1200));
    uint16_t length = (uint16_t)draw(200);
    uint8_t request = (uint8_t)draw(5);
    int size = hapticd_board_control(&board, type, request, value, index, length, reply);
    promise(size >= HAPTICD_STALL && size <= (int)sizeof reply, "no more than a hello");
    promise(board.fit || size == HAPTICD_STALL, "an unfit board answers nothing");
    if (size == 0 && type == 0x40 && request == HAPTICD_REQUEST_CLEAR_FAULT)
        host.latched = world.inputs & CAUSES;
}

/* Change the hardware at random; the firmware is notified at once, or detects it later. */
static void disturb(void)
{
    static const uint16_t bits[] = {
        HAPTICD_STATUS_EMERGENCY_STOP,  HAPTICD_STATUS_AMPLIFIER_READY,
        HAPTICD_STATUS_OVER_TEMPERATURE, HAPTICD_STATUS_AMPLIFIER_FAULT,
        HAPTICD_STATUS_ENCODER_FAULT,
    };
    world.inputs = draw(3) ? HAPTICD_STATUS_AMPLIFIER_READY : world.inputs ^ bits[draw(5)];
    uint32_t encoder = draw(0x10000) << 16 | draw(0x10000);
    world.sensors.encoder = (int32_t)encoder;
    world.sensors.index_passed = draw(2);
    world.sensors.index_count = (int32_t)(encoder + 40000 - draw(80000));
    if (draw(2))
        serve();
}

/* Change the code once, or faster than frames can report. */
static void change_code(void)
{
    for (uint32_t changes = draw(8) ? 1 : draw(40); changes; changes--) {
        world.event_code = (uint16_t)(draw(2) ? draw(4) : draw(0x10000));
        if (draw(4))
            serve();
    }
}

static void step(void)
{
    uint32_t kind = draw(1000);
    if (kind < 600) {
        pass(1000, true);
        send_out(true);
        if (draw(10))
            take();
    } else if (kind < 690) {
        send_out(draw(3) == 0);
    } else if (kind < 700) {
        for (uint32_t burst = draw(40); burst; burst--)
            send_out(true);
    } else if (kind < 800) {
        pass(draw(600), draw(2));
    } else if (kind < 830) {
        pass(draw(30000), draw(2));
    } else if (kind < 832) {
        pass(draw(3000000), true);
    } else if (kind < 880) {
        disturb();
    } else if (kind < 920) {
        change_code();
    } else if (kind < 990) {
        ask();
    } else if (kind < 998) {
        take();
    } else {
        boot();
    }
}

/* Let the clock wrap once and a little more without an action: an age at its maximum must not restart with it. */
static void grow_old(void)
{
    do
        boot();
    while (!board.fit);
    pass(100000, true);
    while (world.now_us < host.born_us + 0x100000000u - 30000)
        pass(29000, false);
    pass((uint32_t)(host.born_us + 0x100000000u + 30000 - world.now_us), false);
    struct hapticd_out out = {0};
    out.flags = HAPTICD_FLAG_ENABLE;
    out.crc = crc16((const uint8_t *)&out, sizeof out - sizeof out.crc);
    promise(hapticd_board_out(&board, (const uint8_t *)&out, sizeof out), "taken, not obeyed");
    obeyed(&out);
    pass(1000, true);
    promise(world.frame.torque_age_us == 65535, "an age is held at 65535");
}

int main(int count, char **words)
{
    unsigned long steps = count > 1 ? strtoul(words[1], NULL, 10) : 100000;
    random_state = 0x9E3779B97F4A7C15u + (count > 2 ? strtoull(words[2], NULL, 10) : 1);
    world.now_us = 0xFFFFFFFFu - 5000000u;
    world.inputs = HAPTICD_STATUS_AMPLIFIER_READY;
    boot();
    while (steps--)
        step();
    grow_old();
    printf("%lu frames, %lu refused, %lu trips, %lu starts, %lu pairs, %lu events\n", met_frames,
           met_refused, met_trips, met_boots, met_pairs, met_events);
    return 0;
}
