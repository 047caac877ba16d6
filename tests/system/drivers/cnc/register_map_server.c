/* A CNC on libmodbus, written from docs/modbus-register-map.md alone.

   register_map_server tcp CLIENTS [ORDER]     prints "port N"
   register_map_server rtu TTY BAUD [ORDER]    prints "ready"

   ORDER abcd (default) is high word and byte first, by hand; libmodbus, badc, cdab and
   dcba take what libmodbus's own modbus_set_float_… makes of 32-bit values.

   A line "delay MS" on standard input makes it slow. Leaves at the end of that. */
#include <arpa/inet.h>
#include <math.h>
#include <modbus/modbus.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/select.h>
#include <time.h>
#include <unistd.h>

enum { IDLE, READY, RUNNING, HELD, FINISHED, ABORTED, ALARM };
enum { MOVE_TO = 1, PUT_ROWS, COMMIT, START, HOLD, RESUME, ABORT, RESET };
enum { DONE, WRONG_STATE, OUT_OF_TRAVEL, NO_PATH, CRC_MISMATCH, BAD_ARGUMENT,
       UNKNOWN_COMMAND, IN_ALARM };
enum { AXES = 3, ROWS = 4096, WORDS = 318 };

typedef struct {
    int32_t position[6];
    uint32_t feed, dwell_ms;
} Row;

static modbus_mapping_t *map;
static uint16_t *words;
static void (*set_float)(float, uint16_t *); /* NULL: by hand */
static const int32_t low[AXES] = {-100000, 0, -3000000}, high[AXES] = {5000000, 4000000, 0};
static const uint32_t max_feed = 30000000;
static Row staged[ROWS], path[ROWS], move, *program;
static int path_rows, program_rows, row;
static double row_s, now_s, beat_s, from[AXES];
static int delay_ms;

static void put32(int address, uint32_t value) {
    float same_bits;
    if (set_float) {
        memcpy(&same_bits, &value, 4);
        set_float(same_bits, words + address);
        return;
    }
    words[address] = value >> 16;
    words[address + 1] = value & 0xFFFF;
}

static uint32_t get32(int address) {
    return (uint32_t)words[address] << 16 | words[address + 1];
}

static void put_text(int address, int registers, const char *text) {
    for (int i = 0; i < registers; i++) {
        int first = *text ? *text++ : 0, second = *text ? *text++ : 0;
        words[address + i] = first << 8 | second;
    }
}

static uint32_t crc32_of(int address, int count, uint32_t crc) {
    for (int i = 0; i < 2 * count; i++) {
        uint16_t word = words[address + i / 2];
        crc ^= i % 2 ? word & 0xFF : word >> 8;
        for (int bit = 0; bit < 8; bit++) crc = crc >> 1 ^ (crc & 1 ? 0xEDB88320u : 0);
    }
    return crc;
}

static double row_time(const Row *to) {
    double square = 0;
    for (int i = 0; i < AXES; i++) square += pow((to->position[i] - from[i]) / 1e4, 2);
    return sqrt(square) / (to->feed / 60e3);
}

static void arrive(void) {
    for (int i = 0; i < AXES; i++) from[i] = program[row].position[i];
    row_s = 0;
    if (row + 1 < program_rows) row++;
    else words[100] = FINISHED;
}

static void advance(void) {
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    double before_s = now_s;
    now_s = time.tv_sec + 1e-9 * time.tv_nsec;
    if (words[100] == RUNNING && now_s - beat_s > 1e-3 * words[181])
        words[100] = HELD, words[101] = 2;
    double step_s = now_s - before_s;
    while (words[100] == RUNNING) {
        double whole_s = row_time(&program[row]) + 1e-3 * program[row].dwell_ms;
        if (row_s + step_s < whole_s) { row_s += step_s; break; }
        step_s -= whole_s - row_s;
        arrive();
    }
    int moving = words[100] == RUNNING || words[100] == HELD;
    for (int i = 0; i < AXES; i++) {
        double travel_s = moving ? row_time(&program[row]) : 0;
        double share = travel_s > 0 ? fmin(row_s / travel_s, 1) : 0;
        double to = moving ? program[row].position[i] : from[i];
        put32(112 + 2 * i, (uint32_t)(int32_t)lround(from[i] + share * (to - from[i])));
    }
    put32(110, words[100] == RUNNING ? program[row].feed : 0);
    words[103] = program == path ? row : 0;
}

static int begin(Row *rows, int count) {
    for (int i = 0; i < AXES; i++) from[i] = (int32_t)get32(112 + 2 * i);
    program = rows, program_rows = count, row = 0, row_s = 0, beat_s = now_s;
    words[100] = RUNNING;
    return DONE;
}

static int parse_row(int address, Row *into) {
    for (int i = 0; i < 6; i++) into->position[i] = (int32_t)get32(address + 2 * i);
    into->feed = get32(address + 12);
    into->dwell_ms = get32(address + 14);
    if (into->feed == 0 || into->feed > max_feed) return BAD_ARGUMENT;
    for (int i = 0; i < AXES; i++)
        if (into->position[i] < low[i] || into->position[i] > high[i]) return OUT_OF_TRAVEL;
    return DONE;
}

static void forget(void) {
    path_rows = words[104] = 0;
    put32(108, 0);
}

static int put_rows(void) {
    static Row fresh[7];
    int first = words[202], count = words[203], fault;
    if (count < 1 || count > 7 || first + count > ROWS) return BAD_ARGUMENT;
    for (int i = 0; i < count; i++)
        if ((fault = parse_row(206 + 16 * i, &fresh[i]))) return fault;
    if (first == 0) {
        forget();
        if (words[100] == READY) words[100] = IDLE;
    }
    memcpy(staged + first, fresh, count * sizeof *fresh);
    return DONE;
}

static int commit(void) {
    uint16_t kept[16];
    int count = words[203];
    uint32_t crc = ~0u;
    if (count < 1 || count > ROWS) return BAD_ARGUMENT;
    memcpy(kept, words + 206, sizeof kept);
    for (int i = 0; i < count; i++) { /* over the bytes in wire order */
        for (int k = 0; k < 6; k++) put32(206 + 2 * k, staged[i].position[k]);
        put32(218, staged[i].feed);
        put32(220, staged[i].dwell_ms);
        crc = crc32_of(206, 16, crc);
    }
    memcpy(words + 206, kept, sizeof kept);
    if (~crc != get32(204)) return CRC_MISMATCH;
    memcpy(path, staged, count * sizeof *path);
    path_rows = words[104] = count;
    put32(108, ~crc);
    words[100] = READY;
    return DONE;
}

static int run(int verb) {
    int state = words[100], fault;
    if (verb < MOVE_TO || verb > RESET) return UNKNOWN_COMMAND;
    if (verb <= START && state == ALARM) return IN_ALARM;
    if (verb <= START && (state == RUNNING || state == HELD)) return WRONG_STATE;
    switch (verb) {
    case MOVE_TO: return (fault = parse_row(206, &move)) ? fault : begin(&move, 1);
    case PUT_ROWS: return put_rows();
    case COMMIT: return commit();
    case START:
        if (!path_rows) return NO_PATH;
        if (words[203] != path_rows || get32(204) != get32(108)) return CRC_MISMATCH;
        return begin(path, path_rows);
    case HOLD:
        if (state == RUNNING) words[100] = HELD, words[101] = 3;
        return DONE;
    case RESUME:
        if (state == HELD) words[100] = RUNNING, words[101] = 0, beat_s = now_s;
        return DONE;
    case ABORT:
        for (int i = 0; i < AXES; i++) from[i] = (int32_t)get32(112 + 2 * i);
        forget();
        words[101] = 0;
        if (state != ALARM) words[100] = ABORTED;
        return DONE;
    }
    if (state == ALARM) words[100] = IDLE, words[102] = 0, put_text(130, 32, "");
    return DONE;
}

static void describe(void) {
    words = map->tab_registers;
    put32(0, 0x54504331);
    put32(2, 0x01020304);
    words[4] = 2, words[5] = AXES, words[18] = ROWS, words[181] = 1000;
    for (int i = 0; i < AXES; i++) {
        words[6 + i] = "XYZ"[i];
        put32(52 + 2 * i, low[i]);
        put32(64 + 2 * i, high[i]);
    }
    put_text(20, 8, "libmodbus");
    put_text(28, 8, LIBMODBUS_VERSION_STRING);
    put_text(36, 8, "C-1");
    put_text(44, 8, "1");
    put32(76, max_feed);
}

static int is_allowed(int function, int first, int count) {
    if (function == MODBUS_FC_READ_HOLDING_REGISTERS) return 1; /* the mapping tells */
    return (first >= 180 && first + count <= 182) || (first >= 200 && first + count <= WORDS);
}

/* A new number comes with its verb and all that the verb reads, or is refused. */
static int is_whole(int function, const uint8_t *pdu, int count) {
    const uint8_t *data = pdu + (function == MODBUS_FC_WRITE_SINGLE_REGISTER ? 3 : 6);
    int number = data[0] << 8 | data[1], needed = 2;
    if (!number || number == words[105]) return 1;
    if (count < 2) return 0;
    int verb = data[2] << 8 | data[3];
    if (verb == COMMIT || verb == START) needed = 6;
    if (verb == MOVE_TO) needed = 22;
    if (verb == PUT_ROWS) needed = 6 + 16 * (count > 3 ? data[6] << 8 | data[7] : 0);
    return count >= (needed < WORDS - 200 ? needed : WORDS - 200);
}

static void reply(modbus_t *link, uint8_t *query, int length) {
    int head = modbus_get_header_length(link), function = query[head];
    int first = query[head + 1] << 8 | query[head + 2];
    int count = function == MODBUS_FC_WRITE_SINGLE_REGISTER
                    ? 1 : query[head + 3] << 8 | query[head + 4];
    uint16_t watchdog = words[181], heartbeat = words[180];
    if (delay_ms) usleep(1000 * delay_ms);
    advance();
    if (!is_allowed(function, first, count)) {
        modbus_reply_exception(link, query, MODBUS_EXCEPTION_ILLEGAL_DATA_ADDRESS);
        return;
    }
    if (first == 200 && function != MODBUS_FC_READ_HOLDING_REGISTERS
        && !is_whole(function, query + head, count)) {
        modbus_reply_exception(link, query, MODBUS_EXCEPTION_ILLEGAL_DATA_VALUE);
        return;
    }
    modbus_reply(link, query, length, map);
    if (words[180] != heartbeat) beat_s = now_s;
    if (words[181] < 100 || words[181] > 10000) words[181] = watchdog;
    int is_order = function == MODBUS_FC_WRITE_MULTIPLE_REGISTERS && first == 200 && count > 1;
    if (is_order && words[200] && words[200] != words[105]) {
        words[106] = run(words[201]);
        words[105] = words[200];
    }
}

static int listen_to_input(void) {
    char line[80];
    if (!fgets(line, sizeof line, stdin)) return -1;
    sscanf(line, "delay %d", &delay_ms);
    printf("done\n");
    fflush(stdout);
    return 0;
}

static void serve(modbus_t *link, int listener, int clients) {
    fd_set known;
    int connected = 0, highest = listener < 0 ? modbus_get_socket(link) : listener;
    uint8_t query[MODBUS_MAX_ADU_LENGTH];
    FD_ZERO(&known);
    FD_SET(highest, &known);
    FD_SET(STDIN_FILENO, &known);
    for (;;) {
        fd_set ready = known;
        struct timeval soon = {0, 10000};
        if (listener >= 0 && connected >= clients) FD_CLR(listener, &ready);
        select(highest + 1, &ready, NULL, NULL, &soon);
        advance();
        if (FD_ISSET(STDIN_FILENO, &ready) && listen_to_input()) return;
        for (int fd = 1; fd <= highest; fd++) {
            if (!FD_ISSET(fd, &ready)) continue;
            if (fd == listener) {
                int fresh = modbus_tcp_accept(link, &listener);
                FD_SET(fresh, &known);
                if (fresh > highest) highest = fresh;
                connected++;
                continue;
            }
            modbus_set_socket(link, fd);
            int length = modbus_receive(link, query);
            if (length > 0) reply(link, query, length);
            if (length < 0 && listener >= 0) {
                close(fd);
                FD_CLR(fd, &known);
                connected--;
            }
        }
    }
}

int main(int argc, char **argv) {
    int is_tcp = argc > 2 && !strcmp(argv[1], "tcp");
    const char *order = argc > 3 + !is_tcp ? argv[3 + !is_tcp] : "abcd";
    if (argc < 3) return 2;
    if (!strcmp(order, "libmodbus")) set_float = modbus_set_float_abcd;
    if (!strcmp(order, "badc")) set_float = modbus_set_float_badc;
    if (!strcmp(order, "cdab")) set_float = modbus_set_float_cdab;
    if (!strcmp(order, "dcba")) set_float = modbus_set_float_dcba;
    map = modbus_mapping_new(0, 0, WORDS, 0);
    describe();
    advance();
    if (!is_tcp) {
        modbus_t *link = modbus_new_rtu(argv[2], atoi(argv[3]), 'N', 8, 1);
        modbus_set_slave(link, 1);
        if (modbus_connect(link)) { perror(argv[2]); return 1; }
        printf("ready\n");
        fflush(stdout);
        serve(link, -1, 1);
        return 0;
    }
    modbus_t *link = modbus_new_tcp("127.0.0.1", 0);
    int listener = modbus_tcp_listen(link, 4);
    struct sockaddr_in bound;
    socklen_t size = sizeof bound;
    if (listener < 0 || getsockname(listener, (struct sockaddr *)&bound, &size)) return 1;
    printf("port %d\n", ntohs(bound.sin_port));
    fflush(stdout);
    serve(link, listener, atoi(argv[2]));
    return 0;
}
