#include "gst_bridge.h"
#include <stdio.h>
#include <stdlib.h>

/* Random bytes, frames with good checks of every length, texts too long, odd numbers. */
static uint32_t state = 20261123u;
static uint32_t draw(void)
{
    state ^= state << 13;
    state ^= state >> 17;
    state ^= state << 5;
    return state;
}

int main(void)
{
    static const double odd[] = {0.0, -0.0, 1e308, -1e308, 1e-308, HUGE_VAL};
    char long_text[200];
    uint8_t out[GST_OUT], body[GST_BODY + 200], frame[2 * GST_BODY];
    size_t most = 0;
    gst_bridge b;
    memset(long_text, 'x', sizeof long_text - 1);
    long_text[sizeof long_text - 1] = 0;
    gst_init(&b, long_text, long_text, long_text, long_text, 1000.0);
    for (int round = 0; round < 200000; round++) {
        size_t n = gst_receive(&b, (uint8_t)(draw() % 5 ? draw() : 0), draw(), out);
        most = n > most ? n : most;
    }
    for (size_t length = 3; length <= GST_BODY + 100; length++) {
        for (int command = 0x1f; command < 0x26; command++) {
            size_t n;
            for (size_t i = 0; i < length; i++)
                body[i] = (uint8_t)draw();
            body[0] = 1;
            body[1] = (uint8_t)command;
            body[3] = 1; /* a good HELLO; START at rates of many kinds */
            body[7] = 0;
            n = gst_frame(body, length, frame);
            for (size_t i = 0; i < n; i++) {
                size_t sent = gst_receive(&b, frame[i], 1, out);
                most = sent > most ? sent : most;
            }
        }
    }
    b.streaming = 1;
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < 6; j++) {
            double xyz[3] = {odd[i], odd[j], odd[(i + j) % 6]};
            size_t n = gst_sample_xyz(&b, UINT64_MAX, xyz, 0xFFFF, 255, out);
            most = n > most ? n : most;
        }
    for (int i = 0; i < 70000; i++) {
        gst_skip(&b, 65535);
        gst_sample(&b, (uint64_t)i, 1.0, 2.0, 3.0, 0, 0, out);
        gst_tick(&b, (uint64_t)i * 1000u, out);
    }
    gst_forget_host(&b);
    printf("%u\n", (unsigned)most);
    return most > GST_OUT;
}
