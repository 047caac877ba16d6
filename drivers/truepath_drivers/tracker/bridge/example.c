/* A bridge over TCP: cc -std=c99 -o bridge example.c -lm && ./bridge 4711
 * In place of an SDK, a target goes round a circle. Prints its port.
 */
#define _POSIX_C_SOURCE 200809L
#include "gst_bridge.h"

#include <arpa/inet.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

static uint64_t clock_us(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000u + (uint64_t)now.tv_nsec / 1000u;
}

static int tell(int host, const uint8_t *bytes, size_t length)
{
    while (length > 0) {
        ssize_t sent = send(host, bytes, length, 0);
        if (sent <= 0)
            return 0;
        bytes += sent;
        length -= (size_t)sent;
    }
    return 1;
}

/* HERE GOES THE SDK: its callback has the time of the instrument and a position. */
static void read_sdk(uint64_t at_us, double xyz_mm[3])
{
    double angle = (double)(at_us % 10000000u) * 6.283185307179586e-7;
    xyz_mm[0] = 2000.0 + 100.0 * cos(angle);
    xyz_mm[1] = 100.0 * sin(angle);
    xyz_mm[2] = 300.0;
}

static void serve(gst_bridge *bridge, int host)
{
    uint8_t out[GST_OUT], in[256];
    uint64_t next_us = 0;
    int was_streaming = 0, alive = 1;
    struct pollfd wait = {0, POLLIN, 0};
    wait.fd = host;
    while (alive) {
        double xyz_mm[3];
        poll(&wait, 1, 2);
        if (wait.revents) {
            ssize_t count = recv(host, in, sizeof in, 0);
            if (count <= 0)
                break;
            for (ssize_t i = 0; i < count && alive; i++)
                alive = tell(host, out, gst_receive(bridge, in[i], clock_us(), out));
        }
        if (bridge->streaming && !was_streaming)
            next_us = clock_us(); /* set the SDK to bridge->rate_hz */
        was_streaming = bridge->streaming;
        while (alive && bridge->streaming && next_us <= clock_us()) {
            read_sdk(next_us, xyz_mm);
            alive = tell(host, out,
                         gst_sample_xyz(bridge, next_us, xyz_mm, 0, 200, out));
            next_us += (uint64_t)(1e6 / bridge->rate_hz + 0.5);
        }
        if (alive)
            alive = tell(host, out, gst_tick(bridge, clock_us(), out));
    }
    gst_forget_host(bridge);
}

int main(int argc, char **argv)
{
    gst_bridge bridge;
    struct sockaddr_in address;
    socklen_t length = sizeof address;
    int server = socket(AF_INET, SOCK_STREAM, 0), yes = 1;
    memset(&address, 0, sizeof address);
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    address.sin_port = htons((uint16_t)(argc > 1 ? atoi(argv[1]) : 0));
    setsockopt(server, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes);
    signal(SIGPIPE, SIG_IGN);
    if (bind(server, (struct sockaddr *)&address, sizeof address) || listen(server, 1))
        return 1;
    getsockname(server, (struct sockaddr *)&address, &length);
    printf("%d\n", ntohs(address.sin_port));
    fflush(stdout);
    gst_init(&bridge, "Example", "C bridge", "0001", "1.0", 1000.0);
    for (;;) {
        int host = accept(server, NULL, NULL);
        if (host < 0)
            return 1;
        serve(&bridge, host);
        close(host);
    }
}
