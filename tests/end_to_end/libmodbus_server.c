/* A Modbus device by libmodbus: registers, and a spring of 2.5 N/V with 10 N preload behind them.

   libmodbus_server tcp         listens on a free port, prints it, serves one client after the other
   libmodbus_server rtu PATH    serves a serial port

   0 identity 20570, 1 map version 1, 2-3 1234.5; 100-101 set point [V], 102 command sequence; 110 watchdog [ms], kept;
   120-121 highest set point [V], 122 writes of it; 200-201 force [N], 202-203 set point again [V], 204 heartbeat,
   205 command sequence again, 206 status, 207-208 temperature [degC]. */

#include <arpa/inet.h>
#include <errno.h>
#include <modbus/modbus.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

enum { REGISTERS = 300, UNIT = 1, SET_POINT = 100, WRITE_MULTIPLE = 16, READ_WRITE = 23 };

/* libmodbus' own modbus_set_float_abcd swaps the bytes of each register before 3.1.7. */
static void put_float(float value, uint16_t *registers)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    registers[0] = bits >> 16;
    registers[1] = bits & 0xFFFF;
}

static float get_float(const uint16_t *registers)
{
    uint32_t bits = (uint32_t)registers[0] << 16 | registers[1];
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* Registers that a request writes stand in the map before it is answered, so that function 23 reads what it has written. */
static void take_written(const uint8_t *pdu, uint16_t *registers)
{
    const uint8_t *head = pdu[0] == READ_WRITE ? pdu + 5 : pdu + 1;
    unsigned address = head[0] << 8 | head[1], count = head[2] << 8 | head[3];
    if ((pdu[0] != READ_WRITE && pdu[0] != WRITE_MULTIPLE) || address + count > REGISTERS || head[4] != 2 * count)
        return;
    for (unsigned k = 0; k < count; k++)
        registers[address + k] = head[5 + 2 * k] << 8 | head[6 + 2 * k];
    if (address == SET_POINT)
        registers[122]++;
}

static void sample(uint16_t *registers)
{
    float voltage = get_float(registers + SET_POINT), highest = get_float(registers + 120);
    if (voltage > highest)
        put_float(voltage, registers + 120);
    put_float(2.5f * voltage + 10.0f, registers + 200);
    put_float(voltage, registers + 202);
    registers[204]++;
    registers[205] = registers[102];
    registers[206] = voltage != 0.0f;
    put_float(25.0f, registers + 207);
}

static void serve(modbus_t *link, modbus_mapping_t *map)
{
    uint8_t query[MODBUS_TCP_MAX_ADU_LENGTH];
    int size, header = modbus_get_header_length(link);
    while ((size = modbus_receive(link, query)) >= 0) {
        if (size == 0)
            continue; /* of another unit */
        take_written(query + header, map->tab_registers);
        sample(map->tab_registers);
        if (modbus_reply(link, query, size, map) < 0)
            return;
    }
}

static int port_of(int listener)
{
    struct sockaddr_in address;
    socklen_t size = sizeof address;
    return getsockname(listener, (struct sockaddr *)&address, &size) < 0 ? -1 : ntohs(address.sin_port);
}

int main(int argc, char **argv)
{
    int rtu = argc == 3 && strcmp(argv[1], "rtu") == 0;
    modbus_t *link = rtu ? modbus_new_rtu(argv[2], 115200, 'N', 8, 1) : modbus_new_tcp("127.0.0.1", 0);
    modbus_mapping_t *map = modbus_mapping_new(0, 0, REGISTERS, 0);
    if (link == NULL || map == NULL || modbus_set_slave(link, UNIT) < 0)
        return 1;
    map->tab_registers[0] = 20570;
    map->tab_registers[1] = 1;
    put_float(1234.5f, map->tab_registers + 2);
    if (rtu) {
        if (modbus_connect(link) < 0)
            return 1;
        printf("0\n");
        fflush(stdout);
        do
            serve(link, map); /* noise ends no serial line */
        while (errno != EIO && errno != ECONNRESET);
        return 0;
    }
    int listener = modbus_tcp_listen(link, 4);
    if (listener < 0)
        return 1;
    printf("%d\n", port_of(listener));
    fflush(stdout);
    while (modbus_tcp_accept(link, &listener) >= 0) {
        serve(link, map);
        modbus_close(link);
    }
    return 0;
}
