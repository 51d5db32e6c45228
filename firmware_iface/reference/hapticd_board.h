/* hapticd_board.h - reference firmware of an analog board: bytes in, bytes out, hardware behind a
 * struct of function pointers. Portable C99: no allocation, no libc but memcpy, memset and memcmp,
 * no floating point but in the self-test at boot.
 *
 * Three of your interrupts call it: a packet arrived (hapticd_board_out), a packet was read
 * (hapticd_board_taken), an action is due (hapticd_board_service). Endpoint 0 calls
 * hapticd_board_control. None of them may interrupt another: give them one priority, or mask the
 * others while one runs. The main loop has no work.
 *
 * Times are values of the port's 32-bit microsecond clock. It wraps after 71.6 minutes; only
 * differences of less than half of that are computed.
 *
 * docs/development/porting-firmware.md specifies each port function and its deadline.
 */
#ifndef HAPTICD_BOARD_H
#define HAPTICD_BOARD_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "hapticd_event.h"
#include "hapticd_probe.h"
#include "hapticd_wire.h"

/* INs that are due for a latch. More than one is queued only if a host sends several OUTs within
 * one period; beyond this number the oldest is dropped. */
#define HAPTICD_LATCHES 16
#define HAPTICD_STALL (-1)

/* Measurements of one instant, sampled together. Counts of the wire; 0 if a board has no sensor. */
struct hapticd_sensors {
    int32_t encoder;
    int16_t current;
    int16_t voltage;
    int16_t emf_velocity;
    int16_t temperature;
    bool index_passed;   /* the index mark has passed since the last call */
    int32_t index_count; /* the encoder at the mark, captured by hardware */
};

/* The hardware. `device` is passed to every call. */
struct hapticd_port {
    void *device;
    uint32_t (*clock_us)(void *device);
    /* present state of EMERGENCY_STOP and AMPLIFIER_READY, and of AMPLIFIER_FAULT, ENCODER_FAULT
     * and OVER_TEMPERATURE those whose cause is present: HAPTICD_STATUS_ bits */
    uint16_t (*inputs)(void *device);
    void (*sense)(void *device, struct hapticd_sensors *sensors);
    /* an interval ends. In: `pair` holds the mean output torque and 0. Out: the mean velocity since
     * the last call (without INTERVAL_MEAN the present velocity) in probe counts. A board that
     * measures the torque through the filter of its velocity writes it to pair[0] */
    void (*measure_pair)(void *device, int16_t pair[2]);
    /* without authority the amplifier makes no current, for any `count` */
    void (*set_torque)(void *device, bool authority, int16_t count);
    void (*set_perturbation)(void *device, int16_t count);
    void (*set_damping)(void *device, uint16_t count);
    void (*set_resistance)(void *device, int16_t count);
    /* the IN endpoint holds this frame from now on; it replaces an unread one */
    void (*send)(void *device, const struct hapticd_in *frame);
    /* the present code at the event pins, once its bits have settled. Called only with the
     * capability EVENT: a board without event pins may leave it NULL */
    uint16_t (*event_code)(void *device);
};

/* The properties of this board. */
struct hapticd_config {
    struct hapticd_hello hello; /* protocol_hash is filled in at boot */
    int16_t torque_limit;       /* counts: hello.force_limit_n, rounded down */
    uint16_t period_us;         /* T */
    uint16_t phase_us;          /* from an OUT to the latch of its IN: 0.875 T */
};

struct hapticd_board {
    const struct hapticd_port *port;
    const struct hapticd_config *config;
    struct hapticd_hello hello;
    bool fit; /* the self-test passed */

    uint32_t origin_us; /* clock at board time 0 */
    uint16_t phase_us;
    uint32_t latch_us[HAPTICD_LATCHES]; /* ring: due times of INs, oldest first */
    uint8_t latch_oldest;
    uint8_t latches;

    uint16_t inputs; /* last read */
    uint16_t faults; /* latched */
    bool live;       /* the commanded torque acts */
    uint8_t torque_seq;
    uint32_t torque_since_us;
    uint16_t damping;

    bool tripped;
    bool alarm_set;
    uint32_t alarm_us; /* when the watchdog trips, or the damping takes its next step down */
    uint32_t release_us;
    uint16_t held_damping;

    bool heard; /* an OUT was accepted */
    uint16_t next_seq;
    uint16_t echo;

    struct hapticd_probe probe;
    struct hapticd_events pins;
    struct hapticd_in frame; /* the newest, as sent */
    bool waiting;            /* not read yet */
    uint16_t events;         /* since the last latch */
    uint16_t frame_events;   /* in this frame */
    uint32_t pairs_end;      /* the interval after its last pair */
    uint16_t in_seq;
    uint8_t life;
    int32_t index_count;
};

/* Call after power-up or a restart of the firmware: outputs off, FIFO empty, self-test. `life` must
 * differ from the last start: increment it in memory that survives a restart, or draw it at random.
 * False: the self-test failed; this board then does not answer and makes no force. `port` and
 * `config` must stay valid. */
bool hapticd_board_boot(struct hapticd_board *board, const struct hapticd_config *config,
                        const struct hapticd_port *port, uint8_t life);

/* A packet of `size` bytes arrived at the OUT endpoint. False: refused, without effect. */
bool hapticd_board_out(struct hapticd_board *board, const uint8_t *data, size_t size);

/* Run all due actions. Call when hapticd_board_wait_us has passed, or more often, and at once when
 * an input changes. */
void hapticd_board_service(struct hapticd_board *board);

/* Return the time until the next due action, 0 if one is due; at most an interval of 250 us. */
uint32_t hapticd_board_wait_us(const struct hapticd_board *board);

/* The host has read the last frame. */
void hapticd_board_taken(struct hapticd_board *board);

/* A vendor request at endpoint 0. Returns the number of bytes in `reply` (HAPTICD_HELLO_BYTES of
 * room), 0 for a request without data, or HAPTICD_STALL. */
int hapticd_board_control(struct hapticd_board *board, uint8_t request_type, uint8_t request,
                          uint16_t value, uint16_t index, uint16_t length, uint8_t *reply);

#endif
