/* Reads "kind hex" lines and writes one JSON line each: the fields and the bytes of the frame encoded again, or the
 * reason of a refusal. It shares only hapticd_wire.h with the Python code, so both agree on the vectors or the header
 * is misread. Like the boards, it expects a little-endian machine. */
#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <string.h>

#include "hapticd_wire.h"

static uint16_t crc16(const uint8_t *data, size_t size)
{
    uint16_t crc = HAPTICD_CRC_INITIAL;
    while (size--) {
        crc ^= (uint16_t)(*data++ << 8);
        for (int bit = 0; bit < 8; bit++)
            crc = (uint16_t)(crc & 0x8000 ? crc << 1 ^ HAPTICD_CRC_POLYNOMIAL : crc << 1);
    }
    return crc;
}

static const char *refusal(const uint8_t *data, size_t size, size_t expected, unsigned count_at, unsigned most, unsigned axis_at)
{
    if (size != expected) return "length";
    uint16_t crc;
    memcpy(&crc, data + size - sizeof crc, sizeof crc);
    if (crc != crc16(data, size - sizeof crc)) return "CRC";
    if (data[count_at] > most) return "count";
    if (data[axis_at] >= HAPTICD_AXIS_COUNT) return "axis";
    return NULL;
}

static void print_hex(const void *frame, size_t size)
{
    const uint8_t *byte = frame;
    printf("}, \"hex\": \"");
    while (size--) printf("%02x", *byte++);
    printf("\"}\n");
}

static const char *take_out(const uint8_t *data, size_t size)
{
    struct hapticd_out in, out = {0};
    const char *error = refusal(data, size, sizeof in, offsetof(struct hapticd_out, probe_count), HAPTICD_PROBE_MAX, offsetof(struct hapticd_out, axis));
    if (error) return error;
    memcpy(&in, data, sizeof in);
    printf("{\"fields\": {\"seq\": %u, \"axis\": %u, \"flags\": %u, ", in.seq, in.axis, in.flags);
    printf("\"torque\": %d, \"damping\": %u, \"resistance\": %d, \"perturbation\": [", in.torque, in.damping, in.resistance);
    for (int i = 0; i < in.probe_count; i++) {
        printf("%s%d", i ? ", " : "", in.perturbation[i]);
        out.perturbation[i] = in.perturbation[i];
    }
    printf("]");
    out.seq = in.seq, out.axis = in.axis, out.flags = in.flags, out.probe_count = in.probe_count;
    out.torque = in.torque, out.damping = in.damping, out.resistance = in.resistance;
    out.crc = crc16((const uint8_t *)&out, sizeof out - sizeof out.crc);
    print_hex(&out, sizeof out);
    return NULL;
}

static const char *take_in(const uint8_t *data, size_t size)
{
    struct hapticd_in in, out = {0};
    const char *error = refusal(data, size, sizeof in, offsetof(struct hapticd_in, probe_count), HAPTICD_PAIR_MAX, offsetof(struct hapticd_in, axis));
    if (error) return error;
    memcpy(&in, data, sizeof in);
    printf("{\"fields\": {\"seq\": %u, \"echo\": %u, \"axis\": %u, \"status\": %u, ", in.seq, in.echo, in.axis, in.status);
    printf("\"board_time_us\": %lu, \"encoder\": %ld, ", (unsigned long)in.board_time_us, (long)in.encoder);
    printf("\"current\": %d, \"voltage\": %d, \"emf_velocity\": %d, ", in.current, in.voltage, in.emf_velocity);
    printf("\"temperature\": %d, \"fifo_level\": %u, \"life\": %u, ", in.temperature, in.fifo_level, in.life);
    printf("\"index_offset\": %d, \"probe_index\": %lu, \"pairs\": [", in.index_offset, (unsigned long)in.probe_index);
    for (int i = 0; i < in.probe_count; i++) {
        printf("%s[%d, %d]", i ? ", " : "", in.pair[i][0], in.pair[i][1]);
        out.pair[i][0] = in.pair[i][0], out.pair[i][1] = in.pair[i][1];
    }
    printf("], \"event_code\": %u, \"event_age_us\": %u, ", in.event_code, in.event_age_us);
    printf("\"torque_age_us\": %u, \"damping_effect\": %u, ", in.torque_age_us, in.damping_effect);
    printf("\"torque_seq\": %u, \"event_seq\": %u", in.torque_seq, in.event_seq);
    out.seq = in.seq, out.echo = in.echo, out.axis = in.axis, out.probe_count = in.probe_count, out.status = in.status;
    out.board_time_us = in.board_time_us, out.encoder = in.encoder, out.current = in.current, out.voltage = in.voltage;
    out.emf_velocity = in.emf_velocity, out.temperature = in.temperature, out.fifo_level = in.fifo_level;
    out.life = in.life, out.index_offset = in.index_offset, out.probe_index = in.probe_index;
    out.event_code = in.event_code, out.event_age_us = in.event_age_us, out.event_seq = in.event_seq;
    out.torque_age_us = in.torque_age_us, out.damping_effect = in.damping_effect, out.torque_seq = in.torque_seq;
    out.crc = crc16((const uint8_t *)&out, sizeof out - sizeof out.crc);
    print_hex(&out, sizeof out);
    return NULL;
}

static const char *take_hello(const uint8_t *data, size_t size)
{
    struct hapticd_hello in, out = {0};
    if (size != sizeof in) return "length";
    memcpy(&in, data, sizeof in);
    for (size_t i = 0; i < sizeof in.serial && in.serial[i]; i++) {
        if (in.serial[i] < ' ' || in.serial[i] > '~') return "serial";
        out.serial[i] = in.serial[i];
    }
    const float scales[] = {in.force_full_scale_n,            in.damping_full_scale_ns_per_m, in.probe_torque_full_scale_n,
                            in.probe_velocity_full_scale_m_s, in.current_full_scale_a,        in.voltage_full_scale_v,
                            in.position_m_per_count,          in.force_limit_n};
    for (size_t i = 0; i < sizeof scales / sizeof *scales; i++)
        if (!isfinite(scales[i])) return "finite";
    printf("{\"fields\": {\"protocol_hash\": \"");
    for (size_t i = 0; i < sizeof in.protocol_hash; i++) printf("%02x", in.protocol_hash[i]);
    printf("\", \"firmware_version\": %u, \"axis_count\": %u, ", in.firmware_version, in.axis_count);
    printf("\"capabilities\": %u, \"watchdog_ms\": %u, \"serial\": \"%.16s\", ", in.capabilities, in.watchdog_ms, out.serial);
    printf("\"force_full_scale_n\": %.17g, \"damping_full_scale_ns_per_m\": %.17g, ", scales[0], scales[1]);
    printf("\"probe_torque_full_scale_n\": %.17g, \"probe_velocity_full_scale_m_s\": %.17g, ", scales[2], scales[3]);
    printf("\"current_full_scale_a\": %.17g, \"voltage_full_scale_v\": %.17g, ", scales[4], scales[5]);
    printf("\"position_m_per_count\": %.17g, \"force_limit_n\": %.17g", scales[6], scales[7]);
    memcpy(out.protocol_hash, in.protocol_hash, sizeof in.protocol_hash);
    out.firmware_version = in.firmware_version, out.axis_count = in.axis_count;
    out.capabilities = in.capabilities, out.watchdog_ms = in.watchdog_ms;
    out.force_full_scale_n = scales[0], out.damping_full_scale_ns_per_m = scales[1];
    out.probe_torque_full_scale_n = scales[2], out.probe_velocity_full_scale_m_s = scales[3];
    out.current_full_scale_a = scales[4], out.voltage_full_scale_v = scales[5];
    out.position_m_per_count = scales[6], out.force_limit_n = scales[7];
    print_hex(&out, sizeof out);
    return NULL;
}

int main(void)
{
    char line[512], kind[8], digits[400];
    while (fgets(line, sizeof line, stdin)) {
        uint8_t data[200];
        size_t size = 0;
        digits[0] = 0;
        if (sscanf(line, "%7s %399s", kind, digits) < 1) return 1;
        for (unsigned byte; size < sizeof data && sscanf(digits + 2 * size, "%2x", &byte) == 1; size++) data[size] = (uint8_t)byte;
        const char *error = !strcmp(kind, "out") ? take_out(data, size) : !strcmp(kind, "in") ? take_in(data, size) : take_hello(data, size);
        if (error) printf("{\"error\": \"%s\"}\n", error);
    }
    return 0;
}
