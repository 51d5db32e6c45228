/* hapticd_board.h - reference firmware of an analog board: bytes in, bytes out, hardware behind a
 * struct of function pointers. Portable C99: no allocation, no libc but memcpy, memset and memcmp,
 * no floating point but in the self-test at boot.
 *
 * Three of your interrupts call it: a packet came (hapticd_board_out), a packet was taken
 * (hapticd_board_taken), something is due (hapticd_board_service); and endpoint 0 asks
 * (hapticd_board_control). None of them may interrupt another: give them one priority, or close
 * the others out while one runs. Nothing runs in the main loop.
 *
 * Times are what the port's 32-bit microsecond clock reads. It wraps after 71.6 minutes; only
 * differences of less than half of that are formed.
 *
 * docs/development/porting-firmware.md says what each port function must do, and within which time.
 */
#ifndef HAPTICD_BOARD_H
#define HAPTICD_BOARD_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "hapticd_event.h"
#include "hapticd_probe.h"
#include "hapticd_wire.h"

/* INs that are still to be latched. More than one waits only where a host sends several OUTs
 * within one period; beyond, the oldest is given up. */
#define HAPTICD_LATCHES 16
#define HAPTICD_STALL (-1)

/* What is known at one instant, all taken together. Counts of the wire; 0 where a board cannot. */
struct hapticd_sensors {
    int32_t encoder;
    int16_t current;
    int16_t voltage;
    int16_t emf_velocity;
    int16_t temperature;
    bool index_passed;   /* the index mark was passed since the last call */
    int32_t index_count; /* the encoder there, caught by hardware */
};

/* The hardware. `device` comes back in every call. */
struct hapticd_port {
    void *device;
    uint32_t (*clock_us)(void *device);
    /* EMERGENCY_STOP and AMPLIFIER_READY as they are at this moment, and of AMPLIFIER_FAULT,
     * ENCODER_FAULT and OVER_TEMPERATURE those whose cause is there now: HAPTICD_STATUS_ bits */
    uint16_t (*inputs)(void *device);
    void (*sense)(void *device, struct hapticd_sensors *sensors);
    /* an interval ends: `pair` holds the mean torque that was output and 0, and takes the mean
     * velocity since the last call (without INTERVAL_MEAN the velocity now) in probe counts. A
     * board that measures the torque behind the filter of its velocity puts that into pair[0] */
    void (*measure_pair)(void *device, int16_t pair[2]);
    /* without authority the amplifier makes no current, whatever `count` says */
    void (*set_torque)(void *device, bool authority, int16_t count);
    void (*set_perturbation)(void *device, int16_t count);
    void (*set_damping)(void *device, uint16_t count);
    void (*set_resistance)(void *device, int16_t count);
    /* the IN endpoint holds this frame from now on, in place of one that was not taken */
    void (*send)(void *device, const struct hapticd_in *frame);
    /* the code at the event pins at this moment, once its bits have settled. Called only with the
     * capability EVENT: a board without event pins may leave it NULL */
    uint16_t (*event_code)(void *device);
};

/* What this very board is. */
struct hapticd_config {
    struct hapticd_hello hello; /* protocol_hash is filled in */
    int16_t torque_limit;       /* counts: hello.force_limit_n, rounded down */
    uint16_t period_us;         /* T */
    uint16_t phase_us;          /* from an OUT to the latch of its IN: 0.875 T */
};

struct hapticd_board {
    const struct hapticd_port *port;
    const struct hapticd_config *config;
    struct hapticd_hello hello;
    bool fit; /* the self-test was passed */

    uint32_t origin_us; /* when board time was 0 */
    uint16_t phase_us;
    uint32_t latch_us[HAPTICD_LATCHES]; /* ring: when INs are due, oldest first */
    uint8_t latch_oldest;
    uint8_t latches;

    uint16_t inputs; /* as read last */
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
    bool waiting;            /* nobody has taken it */
    uint16_t events;         /* since it was latched */
    uint16_t frame_events;   /* that it carries */
    uint32_t pairs_end;      /* the interval after its last pair */
    uint16_t in_seq;
    uint8_t life;
    int32_t index_count;
};

/* Power was connected, or the firmware starts anew: outputs off, FIFO empty, self-test. `life` is
 * another number than at the last start, counted on in memory that survives it or drawn at random.
 * False: the self-test failed; this board then answers nothing and makes no force. `port` and
 * `config` stay where they are. */
bool hapticd_board_boot(struct hapticd_board *board, const struct hapticd_config *config,
                        const struct hapticd_port *port, uint8_t life);

/* A packet of `size` bytes came in at the OUT endpoint. False: refused, nothing of it acts. */
bool hapticd_board_out(struct hapticd_board *board, const uint8_t *data, size_t size);

/* Do what is due. Called when hapticd_board_wait_us has passed, or more often; and at once when an
 * input changes. */
void hapticd_board_service(struct hapticd_board *board);

/* How long until something is due, 0 if it is already; never more than an interval of 250 us. */
uint32_t hapticd_board_wait_us(const struct hapticd_board *board);

/* The host took the frame that was sent last. */
void hapticd_board_taken(struct hapticd_board *board);

/* A vendor request at endpoint 0. The number of bytes in `reply` (HAPTICD_HELLO_BYTES of room), 0
 * for a request without data, or HAPTICD_STALL. */
int hapticd_board_control(struct hapticd_board *board, uint8_t request_type, uint8_t request,
                          uint16_t value, uint16_t index, uint16_t length, uint8_t *reply);

#endif
