/* A minimal Modbus server for function 0x17; its time is mainly that of the wire and the kernel.

   modbus_server tcp        listens on a free port, prints it, serves one client at a time
   modbus_server rtu        serves the other end of the pty on standard input

   The answer is the block of config/bench.yaml: force, voltage read back (as written), heartbeat (counts), command echo. */

#include <arpa/inet.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

enum { READ_WRITE = 0x17, REGISTERS = 16, REQUEST_HEAD = 10, REQUEST_MOST = 260 };

static uint8_t block[2 * REGISTERS]; /* the registers that are read, big-endian */

static uint16_t crc16(const uint8_t *bytes, size_t size)
{
    uint16_t crc = 0xFFFF;
    for (size_t i = 0; i < size; i++) {
        crc ^= bytes[i];
        for (int bit = 0; bit < 8; bit++)
            crc = crc & 1 ? (crc >> 1) ^ 0xA001 : crc >> 1;
    }
    return crc;
}

/* Answers one PDU: function, read address and count, write address and count, byte count, values. Returns its size or 0. */
static size_t answer(const uint8_t *pdu, uint8_t *reply)
{
    static uint16_t heartbeat;
    size_t size = 2 * (size_t)pdu[4];
    if (pdu[0] != READ_WRITE || pdu[3] != 0 || size > sizeof block || pdu[9] < 6)
        return 0;
    memcpy(block + 4, pdu + REQUEST_HEAD, 4);
    memcpy(block + 10, pdu + REQUEST_HEAD + 4, 2);
    heartbeat++;
    block[8] = heartbeat >> 8;
    block[9] = heartbeat & 0xFF;
    reply[0] = READ_WRITE;
    reply[1] = (uint8_t)size;
    memcpy(reply + 2, block, size);
    return size + 2;
}

/* Reads until `size` bytes are there; 0 when the other side has gone. */
static int fill(int from, uint8_t *bytes, size_t have, size_t size)
{
    while (have < size) {
        ssize_t got = read(from, bytes + have, size - have);
        if (got <= 0)
            return 0;
        have += (size_t)got;
    }
    return 1;
}

static void serve_tcp(int client)
{
    uint8_t request[REQUEST_MOST], reply[REQUEST_MOST];
    for (;;) {
        ssize_t got = read(client, request, sizeof request);
        if (got <= 0)
            return;
        if (got < 6 && !fill(client, request, (size_t)got, 6))
            return;
        size_t length = (size_t)request[4] << 8 | request[5];
        if (length > sizeof request - 6 || ((size_t)got < 6 + length && !fill(client, request, (size_t)got, 6 + length)))
            return;
        size_t size = answer(request + 7, reply + 7);
        memcpy(reply, request, 7);
        reply[4] = 0;
        reply[5] = (uint8_t)(size + 1);
        if (size == 0 || write(client, reply, 7 + size) < 0)
            return;
    }
}

static void serve_rtu(int port)
{
    uint8_t request[REQUEST_MOST], reply[REQUEST_MOST];
    for (;;) {
        ssize_t got = read(port, request, sizeof request);
        if (got <= 0)
            return;
        size_t head = 1 + REQUEST_HEAD;
        if ((size_t)got < head && !fill(port, request, (size_t)got, head))
            return;
        size_t whole = head + request[10] + 2;
        if (whole > sizeof request || ((size_t)got < whole && !fill(port, request, (size_t)got, whole)))
            return;
        size_t size = answer(request + 1, reply + 1);
        if (size == 0 || crc16(request, whole) != 0)
            return;
        reply[0] = request[0];
        uint16_t crc = crc16(reply, 1 + size);
        reply[1 + size] = crc & 0xFF;
        reply[2 + size] = crc >> 8;
        if (write(port, reply, 3 + size) < 0)
            return;
    }
}

static int listen_tcp(void)
{
    struct sockaddr_in address = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    socklen_t size = sizeof address;
    int listener = socket(AF_INET, SOCK_STREAM, 0);
    if (listener < 0 || bind(listener, (struct sockaddr *)&address, size) < 0 || listen(listener, 4) < 0
        || getsockname(listener, (struct sockaddr *)&address, &size) < 0)
        return -1;
    printf("%d\n", ntohs(address.sin_port));
    fflush(stdout);
    return listener;
}

int main(int argc, char **argv)
{
    static const uint8_t force_10_N[4] = {0x41, 0x20, 0, 0};
    memcpy(block, force_10_N, sizeof force_10_N);
    if (argc == 2 && strcmp(argv[1], "rtu") == 0) {
        serve_rtu(STDIN_FILENO);
        return 0;
    }
    int listener = listen_tcp(), on = 1, client;
    if (listener < 0)
        return 1;
    while ((client = accept(listener, NULL, NULL)) >= 0) {
        setsockopt(client, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
        serve_tcp(client);
        close(client);
    }
    return 0;
}
