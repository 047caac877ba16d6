/* Sensors on libmodbus: prints "port N", serves one host after another on TCP.

   Input registers 0 and 1: 205 and -15 (int16). Holding registers 10 to 13: 21.5 as
   float, high word first, then 1002.25, low word first. */
#include <arpa/inet.h>
#include <modbus/modbus.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

static void put_float(float value, uint16_t *high, uint16_t *low) {
    uint32_t bits;
    memcpy(&bits, &value, 4);
    *high = bits >> 16;
    *low = bits & 0xFFFF;
}

int main(void) {
    modbus_t *bus = modbus_new_tcp("127.0.0.1", 0);
    modbus_mapping_t *map = modbus_mapping_new(0, 0, 20, 4);
    struct sockaddr_in at = {0};
    socklen_t size = sizeof at;
    uint8_t query[MODBUS_TCP_MAX_ADU_LENGTH];
    int listener = modbus_tcp_listen(bus, 1);
    if (listener < 0 || map == NULL) return 1;
    getsockname(listener, (struct sockaddr *)&at, &size);
    map->tab_input_registers[0] = 205;
    map->tab_input_registers[1] = (uint16_t)-15;
    put_float(21.5f, map->tab_registers + 10, map->tab_registers + 11);
    put_float(1002.25f, map->tab_registers + 13, map->tab_registers + 12);
    printf("port %d\n", ntohs(at.sin_port));
    fflush(stdout);
    while (modbus_tcp_accept(bus, &listener) >= 0) {
        int length;
        while ((length = modbus_receive(bus, query)) >= 0)
            if (length > 0) modbus_reply(bus, query, length, map);
        modbus_close(bus);
    }
    return 0;
}
