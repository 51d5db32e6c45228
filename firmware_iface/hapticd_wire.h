/* hapticd_wire.h - the authoritative definition of the wire between the hapticd host and an analog board.
 *
 * One OUT and one IN frame per servo tick, each inside one 64-byte full-speed packet. Little-endian, no padding.
 * Both end in CRC-16/CCITT-FALSE (poly 0x1021, init 0xFFFF, no reflection, no xor) over all bytes before it.
 * Signs: a positive force count pushes to positive x; a positive encoder count is positive x before calibration.
 * Counts are calibrated by the device file on the host; the hello reply gives nominal full scales only.
 * PROTOCOL.md explains every field and decodes one whole frame in each direction.
 *
 * HAPTICD_PROTOCOL_HASH is made from this very file, in this order:
 *   1. remove every comment, both the block form like this one and the form of two slashes up to the end of the line;
 *   2. remove the one line that defines HAPTICD_PROTOCOL_HASH;
 *   3. remove all white space: space, tab, line feed, carriage return, vertical tab, form feed;
 *   4. take SHA-256 over what is left, as ASCII;
 *   5. keep the first 8 bytes and write them as hexadecimal digits, first byte first, after 0x and before ULL.
 * So a changed comment keeps the hash and a changed field or constant does not. A host refuses a board that reports another.
 */
#ifndef HAPTICD_WIRE_H
#define HAPTICD_WIRE_H

#include <stdint.h>

#define HAPTICD_PROTOCOL_HASH 0x016b7228b39ec3caULL

#define HAPTICD_USB_VENDOR_ID 0x1209
#define HAPTICD_USB_PRODUCT_ID 0x0001
#define HAPTICD_PACKET_BYTES 64
#define HAPTICD_OUT_BYTES 32
#define HAPTICD_IN_BYTES 64
#define HAPTICD_HELLO_BYTES 80
#define HAPTICD_AXIS_COUNT 1         /* frames carry an axis index; this protocol has one axis */
#define HAPTICD_PROBE_MAX 6          /* perturbation samples in one OUT */
#define HAPTICD_PAIR_MAX 5           /* measured pairs in one IN */
#define HAPTICD_FIFO_DEPTH 16        /* perturbation samples the board holds */
#define HAPTICD_FIFO_TARGET 8        /* level at which the host aims */
#define HAPTICD_PROBE_RATE_HZ 4000   /* the board's own sample clock */
#define HAPTICD_EVENT_DEPTH 16       /* events at the pins that the board holds, the one in its frames included */
#define HAPTICD_EVENT_FRAMES 2       /* frames with an event that the host takes before the next event follows */
#define HAPTICD_CRC_POLYNOMIAL 0x1021
#define HAPTICD_CRC_INITIAL 0xFFFF

/* vendor control requests, recipient device */
#define HAPTICD_REQUEST_HELLO 0x01       /* IN, HAPTICD_HELLO_BYTES */
#define HAPTICD_REQUEST_CLEAR_FAULT 0x02 /* OUT, no data: clears the latched board faults if their cause is gone */
#define HAPTICD_REQUEST_SAMPLE_PHASE 0x03 /* OUT, no data, wValue = us from the acceptance of an OUT to the latch of its IN */

/* OUT flags */
#define HAPTICD_FLAG_ENABLE 0x01      /* torque authority: without it the board outputs no torque */
#define HAPTICD_FLAG_FIFO_CLEAR 0x02  /* drop queued perturbation samples before taking those of this frame */
#define HAPTICD_FLAG_PERTURB 0x04     /* play the perturbation FIFO; an empty FIFO is then an under-run */

/* IN status */
#define HAPTICD_STATUS_ENABLED 0x0001        /* torque authority is granted: the commanded torque acts at this very latch */
#define HAPTICD_STATUS_WATCHDOG 0x0002       /* latched: no valid OUT in time, torque is 0; cleared by an OUT without ENABLE */
#define HAPTICD_STATUS_BAD_FRAME 0x0004      /* an OUT was refused since the last IN: length, CRC, axis or probe count */
#define HAPTICD_STATUS_SEQ_GAP 0x0008        /* OUT sequence jumped since the last IN */
#define HAPTICD_STATUS_FORCE_CLAMPED 0x0010  /* torque command beyond the board's own limit was clamped */
#define HAPTICD_STATUS_FIFO_UNDERRUN 0x0020  /* perturbation ran dry since the last IN: 0 was output */
#define HAPTICD_STATUS_FIFO_OVERFLOW 0x0040  /* perturbation samples were dropped since the last IN */
#define HAPTICD_STATUS_OVER_TEMPERATURE 0x0080 /* latched: torque is 0; cleared by REQUEST_CLEAR_FAULT */
#define HAPTICD_STATUS_AMPLIFIER_FAULT 0x0100  /* latched, as above */
#define HAPTICD_STATUS_ENCODER_FAULT 0x0200    /* latched, as above */
#define HAPTICD_STATUS_INDEX 0x0400          /* the index mark was passed since the last IN; index_offset is valid */
#define HAPTICD_STATUS_PROBE_OVERFLOW 0x0800 /* pairs were lost because the host did not read */
#define HAPTICD_STATUS_EMERGENCY_STOP 0x1000 /* the hard-wired stop is pressed: no torque, whatever the host asks */
#define HAPTICD_STATUS_AMPLIFIER_READY 0x2000 /* the amplifier is powered and could make torque */
#define HAPTICD_STATUS_SIMULATED 0x8000      /* no real device: always set together with the capability */

/* capabilities in the hello reply */
#define HAPTICD_CAPABILITY_PROBE 0x0001         /* takes perturbation samples and sends pairs */
#define HAPTICD_CAPABILITY_INTERVAL_MEAN 0x0002 /* pairs are means over their 250 us; else instants at its end */
#define HAPTICD_CAPABILITY_INDEX 0x0004         /* the encoder has an index mark */
#define HAPTICD_CAPABILITY_TEMPERATURE 0x0008   /* the winding temperature is measured, else the field is 0 */
#define HAPTICD_CAPABILITY_RESISTANCE 0x0010    /* the resistance-compensation DAC is connected */
#define HAPTICD_CAPABILITY_EMERGENCY_STOP 0x0020 /* a hard-wired stop is connected and reported in the status */
#define HAPTICD_CAPABILITY_AMPLIFIER_READY 0x0040 /* AMPLIFIER_READY is reported; without it the bit is 0 */
#define HAPTICD_CAPABILITY_SAMPLE_PHASE 0x0080  /* REQUEST_SAMPLE_PHASE is obeyed, else the phase is 0.875 of the period */
#define HAPTICD_CAPABILITY_RESISTANCE_MEASURED 0x0100 /* reserved for a measured winding resistance: 0 */
#define HAPTICD_CAPABILITY_RESISTANCE_TRACKED 0x0200 /* reserved for compensation that follows the winding by itself: 0 */
#define HAPTICD_CAPABILITY_EVENT 0x0400         /* the event pins are connected, else the event fields are 0 */
#define HAPTICD_CAPABILITY_SIMULATED 0x8000     /* the device behind this board is computed */

#pragma pack(push, 1)

struct hapticd_out {
    uint16_t seq;              /* +1 per frame */
    uint8_t axis;              /* 0..HAPTICD_AXIS_COUNT - 1 */
    uint8_t flags;             /* HAPTICD_FLAG_ */
    int16_t torque;            /* torque command DAC */
    uint16_t damping;          /* damping scale-factor DAC, 0 = none */
    int16_t resistance;        /* resistance-compensation DAC, 0 = nominal */
    uint8_t probe_count;       /* 0..HAPTICD_PROBE_MAX valid samples below */
    uint8_t reserved0;         /* 0 */
    int16_t perturbation[HAPTICD_PROBE_MAX]; /* perturbation samples for the FIFO, one per 250 us */
    uint8_t reserved[6];       /* 0 */
    uint16_t crc;              /* over all bytes before it */
};

struct hapticd_in {
    uint16_t seq;              /* +1 per frame */
    uint16_t echo;             /* seq of the last OUT accepted */
    uint8_t axis;              /* 0..HAPTICD_AXIS_COUNT - 1 */
    uint8_t probe_count;       /* 0..HAPTICD_PAIR_MAX valid pairs below */
    uint16_t status;           /* HAPTICD_STATUS_ */
    uint32_t board_time_us;    /* when the encoder was latched; wraps */
    int32_t encoder;           /* counts; wraps */
    int16_t current;           /* motor current */
    int16_t voltage;           /* motor voltage */
    int16_t emf_velocity;      /* velocity estimate from the back-EMF */
    int16_t temperature;       /* winding temperature */
    uint8_t fifo_level;        /* perturbation samples queued */
    uint8_t life;              /* counted on or drawn at every start of the firmware; constant within one */
    int16_t index_offset;      /* encoder - count at the index mark, valid with STATUS_INDEX */
    uint32_t probe_index;      /* index of the first pair below, counts 250 us intervals since power-up; wraps */
    int16_t pair[HAPTICD_PAIR_MAX][2]; /* mean perturbation torque, mean velocity over the interval */
    uint16_t event_code;       /* code at the event pins since event `event_seq` */
    uint16_t event_age_us;     /* time from that event to the latch; 65535 stands for longer too */
    uint16_t torque_age_us;    /* time since the torque of OUT `torque_seq` took effect; 65535 stands for longer too */
    uint16_t damping_effect;   /* damping scale factor in effect, in counts of the DAC */
    uint8_t torque_seq;        /* low byte of the seq of the OUT whose torque is in effect */
    uint8_t event_seq;         /* number of that event, +1 per change of the code since power-up; wraps */
    uint16_t crc;              /* over all bytes before it */
};

struct hapticd_hello {
    uint8_t protocol_hash[8];  /* HAPTICD_PROTOCOL_HASH, first byte first */
    uint16_t firmware_version; /* major << 8 | minor */
    uint8_t axis_count;        /* HAPTICD_AXIS_COUNT */
    uint8_t reserved0;         /* 0 */
    uint16_t capabilities;     /* HAPTICD_CAPABILITY_ */
    uint16_t watchdog_ms;      /* longest time without a valid OUT, not 0 */
    char serial[16];           /* printable ASCII, zero-padded, not terminated when full */
    float force_full_scale_n;           /* at torque = 32767 */
    float damping_full_scale_ns_per_m;  /* at damping = 65535 */
    float probe_torque_full_scale_n;    /* at perturbation = 32767 */
    float probe_velocity_full_scale_m_s; /* at velocity = 32767 */
    float current_full_scale_a;         /* at current = 32767 */
    float voltage_full_scale_v;         /* at voltage = 32767 */
    float position_m_per_count;         /* per encoder count */
    float force_limit_n;                /* the board clamps beyond */
    uint8_t reserved[16];               /* 0 */
};

#pragma pack(pop)

#endif
