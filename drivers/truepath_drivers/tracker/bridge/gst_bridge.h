/* GST/1, the device's side: what a tracker sends, in one C99 header.
 *
 * A bridge is a small program beside a maker's SDK: it hands samples of the SDK on as
 * GST/1 frames, over serial or TCP. No I/O, no memory of its own, no threads here: call
 * from one thread, or lock. Bytes to send are written to `out`, GST_OUT bytes or more;
 * the functions return how many.
 */
#ifndef GST_BRIDGE_H
#define GST_BRIDGE_H

#include <math.h>
#include <stdint.h>
#include <string.h>

#define GST_OUT 1024
#define GST_BODY 500
#define GST_PATIENCE_US 5000000u
#define GST_STATUS_US 500000u

/* Status of a sample: the low byte forbids its use, the high byte informs. */
enum {
    GST_BEAM_BROKEN = 0x0001,
    GST_DISTANCE_INVALID = 0x0002,
    GST_OVER_SPEED = 0x0004,
    GST_OUT_OF_RANGE = 0x0008,
    GST_OVERFLOW = 0x1000
};

typedef struct {
    const char *maker, *model, *serial_number, *firmware; /* UTF-8, 60 bytes each */
    double max_rate_hz;
    int streaming;      /* set by START, cleared by STOP: obey it */
    double rate_hz;     /* asked for by START: set the SDK to it */
    uint16_t sequence;  /* of the next sample; counts on over STOP and START */
    uint32_t rate_mhz, frames_sent, frames_dropped, high_water;
    uint64_t heard_us, told_us;
    uint8_t piece[GST_BODY + 8];
    size_t piece_length;
} gst_bridge;

static inline void gst_init(gst_bridge *b, const char *maker, const char *model,
                     const char *serial_number, const char *firmware,
                     double max_rate_hz)
{
    memset(b, 0, sizeof *b);
    b->maker = maker;
    b->model = model;
    b->serial_number = serial_number;
    b->firmware = firmware;
    b->max_rate_hz = max_rate_hz;
}

static inline uint32_t gst_crc(const uint8_t *data, size_t length)
{
    uint32_t crc = 0xFFFFFFFFu;
    for (size_t i = 0; i < length; i++) {
        crc ^= data[i];
        for (int bit = 0; bit < 8; bit++)
            crc = (crc >> 1) ^ (0xEDB88320u & (0u - (crc & 1u)));
    }
    return crc ^ 0xFFFFFFFFu;
}

static inline size_t gst_put(uint8_t *at, uint64_t value, size_t bytes)
{
    for (size_t i = 0; i < bytes; i++)
        at[i] = (uint8_t)(value >> (8 * i));
    return bytes;
}

static inline size_t gst_put_double(uint8_t *at, double value)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    return gst_put(at, bits, 8);
}

static inline size_t gst_put_text(uint8_t *at, const char *text)
{
    size_t length = strlen(text);
    if (length > 60)
        length = 60;
    at[0] = (uint8_t)length;
    memcpy(at + 1, text, length);
    return length + 1;
}

/* Write the frame of a body, whose last four bytes are free for the CRC. */
static inline size_t gst_frame(uint8_t *body, size_t length, uint8_t *out)
{
    size_t code_at = 1, at = 2;
    gst_put(body + length, gst_crc(body, length), 4);
    length += 4;
    out[0] = 0;
    for (size_t i = 0; i < length; i++) {
        if (at - code_at == 255) { /* 254 bytes without a zero */
            out[code_at] = 255;
            code_at = at++;
        }
        if (body[i] == 0) {
            out[code_at] = (uint8_t)(at - code_at);
            code_at = at++;
        } else {
            out[at++] = body[i];
        }
    }
    out[code_at] = (uint8_t)(at - code_at);
    out[at++] = 0;
    return at;
}

static inline size_t gst_begin(uint8_t *body, uint8_t type)
{
    body[0] = 1;
    body[1] = type;
    return 2;
}

/* Count samples that the SDK has lost before the next one. */
static inline void gst_skip(gst_bridge *b, uint16_t samples)
{
    b->sequence = (uint16_t)(b->sequence + samples);
    b->frames_dropped += samples;
}

/* A sample. clock_us: of the instrument, when it was taken, never when it arrived. */
static inline size_t gst_sample(gst_bridge *b, uint64_t clock_us, double range_m,
                         double azimuth_rad, double elevation_rad, uint16_t status,
                         uint8_t signal, uint8_t *out)
{
    uint8_t body[64];
    size_t n = gst_begin(body, 0x14);
    if (!b->streaming)
        return 0;
    n += gst_put(body + n, b->sequence++, 2);
    n += gst_put(body + n, clock_us, 8);
    n += gst_put_double(body + n, range_m);
    n += gst_put_double(body + n, azimuth_rad);
    n += gst_put_double(body + n, elevation_rad);
    n += gst_put(body + n, status, 2);
    n += gst_put(body + n, signal, 1);
    n += gst_put(body + n, 0, 1);
    b->frames_sent++;
    return gst_frame(body, n, out);
}

/* The same from positions in mm, right-handed, z up. */
static inline size_t gst_sample_xyz(gst_bridge *b, uint64_t clock_us,
                                    const double xyz_mm[3], uint16_t status,
                                    uint8_t signal, uint8_t *out)
{
    double x = xyz_mm[0] / 1e3, y = xyz_mm[1] / 1e3, z = xyz_mm[2] / 1e3;
    double level = sqrt(x * x + y * y);
    return gst_sample(b, clock_us, sqrt(level * level + z * z), atan2(y, x),
                      atan2(z, level), status, signal, out);
}

/* An event: 1 beam broken, 2 beam locked, 4 trigger. */
static inline size_t gst_event(uint8_t code, uint64_t clock_us, uint8_t *out)
{
    uint8_t body[32];
    size_t n = gst_begin(body, 0x13);
    n += gst_put(body + n, code, 1);
    n += gst_put(body + n, clock_us, 8);
    return gst_frame(body, n, out);
}

static inline size_t gst_nak(const uint8_t *command, uint8_t code, const char *text,
                      uint8_t *out)
{
    uint8_t body[96];
    size_t n = gst_begin(body, 0x31);
    n += gst_put(body + n, command[2], 1);
    n += gst_put(body + n, command[1], 1);
    n += gst_put(body + n, code, 1);
    n += gst_put_text(body + n, text);
    return gst_frame(body, n, out);
}

static inline size_t gst_obey_start(gst_bridge *b, const uint8_t *command,
                                    size_t length, uint8_t *ack, size_t n,
                                    uint64_t clock_us, uint8_t *out)
{
    uint32_t rate_mhz = 0;
    if (length != 8)
        return gst_nak(command, 2, "START has 8 bytes", out);
    if (command[7] != 0)
        return gst_nak(command, 2, "MEAS64 only", out);
    for (int i = 0; i < 4; i++)
        rate_mhz |= (uint32_t)command[3 + i] << (8 * i);
    if (rate_mhz == 0 || rate_mhz / 1e3 > b->max_rate_hz)
        return gst_nak(command, 3, "rate not possible", out);
    if (b->streaming && rate_mhz != b->rate_mhz)
        return gst_nak(command, 4, "streams at another rate", out);
    b->streaming = 1;
    b->rate_mhz = rate_mhz;
    b->rate_hz = rate_mhz / 1e3;
    n += gst_put(ack + n, rate_mhz, 4);
    n += gst_put(ack + n, b->sequence, 2);
    n += gst_put(ack + n, clock_us, 8);
    return gst_frame(ack, n, out);
}

static inline size_t gst_obey(gst_bridge *b, const uint8_t *command, size_t length,
                       uint64_t clock_us, uint8_t *out)
{
    uint8_t ack[320];
    size_t n = gst_begin(ack, 0x30);
    n += gst_put(ack + n, command[2], 1);
    n += gst_put(ack + n, command[1], 1);
    switch (command[1]) {
    case 0x20: /* HELLO */
        if (length != 4 || command[3] != 1)
            return gst_nak(command, 6, "version 1 only", out);
        n += gst_put(ack + n, 1, 1);
        n += gst_put(ack + n, (uint64_t)(b->max_rate_hz * 1e3 + 0.5), 4);
        n += gst_put_text(ack + n, b->maker);
        n += gst_put_text(ack + n, b->model);
        n += gst_put_text(ack + n, b->serial_number);
        n += gst_put_text(ack + n, b->firmware);
        return gst_frame(ack, n, out);
    case 0x21: /* START */
        b->heard_us = clock_us;
        return gst_obey_start(b, command, length, ack, n, clock_us, out);
    case 0x22: /* STOP */
        b->streaming = 0;
        return gst_frame(ack, n, out);
    case 0x23: /* PING */
        b->heard_us = clock_us;
        return gst_frame(ack, n, out);
    default:
        return gst_nak(command, 1, "unknown command", out);
    }
}

/* Return the length of the body in a piece, decoded in place; 0 if it is damaged. */
static inline size_t gst_open(uint8_t *piece, size_t length)
{
    size_t from = 0, to = 0;
    uint8_t crc[4];
    while (from < length) {
        size_t code = piece[from++];
        if (from + code - 1 > length)
            return 0;
        for (size_t i = 1; i < code; i++)
            piece[to++] = piece[from++];
        if (code < 255 && from < length)
            piece[to++] = 0;
    }
    if (to < 7)
        return 0;
    gst_put(crc, gst_crc(piece, to - 4), 4);
    return memcmp(crc, piece + to - 4, 4) == 0 && piece[0] == 1 ? to - 4 : 0;
}

/* A byte from the host; returns the length of the reply, 0 if there is none yet. */
static inline size_t gst_receive(gst_bridge *b, uint8_t byte, uint64_t clock_us,
                                 uint8_t *out)
{
    size_t length = 0;
    if (byte != 0) {
        if (b->piece_length < sizeof b->piece)
            b->piece[b->piece_length++] = byte;
        return 0;
    }
    if (b->piece_length < sizeof b->piece)
        length = gst_open(b->piece, b->piece_length);
    b->piece_length = 0;
    return length ? gst_obey(b, b->piece, length, clock_us, out) : 0;
}

/* Call often: STATUS twice a second, and the end of a stream that nobody wants. */
static inline size_t gst_tick(gst_bridge *b, uint64_t clock_us, uint8_t *out)
{
    uint8_t body[64];
    size_t n = gst_begin(body, 0x12);
    if (b->streaming && clock_us - b->heard_us > GST_PATIENCE_US) {
        b->streaming = 0;
        return gst_event(3, clock_us, out);
    }
    if (clock_us - b->told_us < GST_STATUS_US)
        return 0;
    b->told_us = clock_us;
    n += gst_put(body + n, b->streaming ? 1 : 0, 1);
    n += gst_put(body + n, clock_us, 8);
    n += gst_put(body + n, b->frames_sent, 4);
    n += gst_put(body + n, b->frames_dropped, 4);
    n += gst_put(body + n, b->high_water, 4);
    return gst_frame(body, n, out);
}

/* The host has gone. */
static inline void gst_forget_host(gst_bridge *b)
{
    b->streaming = 0;
    b->piece_length = 0;
}

#endif
