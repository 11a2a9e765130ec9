/* libmodbus asks the emulated bench, by every function it knows; what came back is printed, a `name value` a line.

   libmodbus_client tcp HOST PORT
   libmodbus_client rtu PATH BAUDRATE */

#include <errno.h>
#include <modbus/modbus.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { UNIT = 1, BLOCK = 12, SETTLE_US = 100000 };

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

static int failed(const char *what)
{
    printf("failed %s: %s\n", what, modbus_strerror(errno));
    return 1;
}

int main(int argc, char **argv)
{
    if (argc != 4)
        return 2;
    int rtu = strcmp(argv[1], "rtu") == 0, baudrate = atoi(argv[3]);
    modbus_t *link = rtu ? modbus_new_rtu(argv[2], baudrate, 'N', 8, 1) : modbus_new_tcp(argv[2], atoi(argv[3]));
    if (link == NULL || modbus_set_slave(link, UNIT) < 0 || modbus_connect(link) < 0)
        return failed("connect");
    modbus_set_response_timeout(link, 2, 0);

    uint16_t words[BLOCK];
    if (modbus_read_registers(link, 0, 4, words) != 4)
        return failed("identity");
    printf("identity %u\nversion %u\norder_check %.1f\n", words[0], words[1], get_float(words + 2));

    put_float(60.0f, words);
    words[2] = 7;
    if (modbus_write_registers(link, 100, 3, words) != 3)
        return failed("write of several");
    usleep(SETTLE_US);
    if (modbus_read_registers(link, 200, BLOCK, words) != BLOCK)
        return failed("holding registers");
    printf("force_at_60_V %.3f\nreadback_at_60_V %.3f\necho %u\n", get_float(words),
           get_float(words + 2), words[5]);
    if (modbus_read_input_registers(link, 200, BLOCK, words) != BLOCK)
        return failed("input registers");
    printf("readback_as_input %.3f\n", get_float(words + 2));

    if (modbus_write_register(link, 102, 4711) != 1 || modbus_read_registers(link, 205, 1, words) != 1)
        return failed("write of one");
    printf("echo_of_one %u\n", words[0]);

    uint16_t read[BLOCK];
    put_float(90.0f, words);
    words[2] = 8;
    if (modbus_write_and_read_registers(link, 100, 3, words, 200, BLOCK, read) != BLOCK)
        return failed("write and read");
    printf("echo_of_both %u\n", read[5]);
    usleep(SETTLE_US);
    if (modbus_write_and_read_registers(link, 100, 3, words, 200, BLOCK, read) != BLOCK)
        return failed("write and read");
    printf("readback_at_90_V %.3f\nforce_at_90_V %.3f\n", get_float(read + 2), get_float(read));

    printf("no_such_address %d\n", modbus_read_registers(link, 150, 1, words) < 0 && errno == EMBXILADD);
    put_float(500.0f, words);
    printf("too_high %d\n", modbus_write_registers(link, 100, 3, words) < 0 && errno == EMBXILVAL);
    put_float(0.0f, words);
    printf("back_to_rest %d\n", modbus_write_registers(link, 100, 3, words) == 3);
    modbus_close(link);
    return 0;
}
