/* Times the exchanges of libmodbus: function 0x17 with the block of config/bench.yaml.

   modbus_client tcp HOST PORT COUNT PERIOD_US
   modbus_client rtu PATH BAUDRATE COUNT PERIOD_US

   PERIOD_US 0: successive exchanges (on a serial line after the silence between frames), and the duration of each.
   Otherwise: one exchange in each period, as in the control process (SCHED_FIFO, locked memory, latency request), and
   the time from its deadline to its end; a missed deadline is skipped.
   Prints COUNT numbers [ns], one on each line; exits with 1 when an exchange fails. */

#include <errno.h>
#include <fcntl.h>
#include <modbus/modbus.h>
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

enum { WARM_UP = 200, UNIT = 1, WRITE_AT = 100, WRITES = 3, READ_AT = 200, READS = 12, PRIORITY = 80,
       SILENCE_NS = 20000 };

static int64_t now_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * INT64_C(1000000000) + now.tv_nsec;
}

static int exchange(modbus_t *link)
{
    static uint16_t sequence;
    uint16_t written[WRITES], read[READS];
    modbus_set_float_abcd(0.0f, written);
    written[2] = ++sequence;
    return modbus_write_and_read_registers(link, WRITE_AT, WRITES, written, READ_AT, READS, read) == READS ? 0 : -1;
}

static int64_t sleep_until_next(int64_t deadline, int64_t period)
{
    int64_t late = now_ns() - (deadline += period);
    if (late >= 0)
        deadline += (late / period + 1) * period;
    struct timespec at = {deadline / 1000000000, deadline % 1000000000};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &at, NULL) == EINTR)
        ;
    return deadline;
}

static int64_t wait_silence(int64_t silence)
{
    int64_t now, end = now_ns() + silence;
    do
        now = now_ns();
    while (now < end);
    return now;
}

static void be_real_time(void)
{
    struct sched_param priority = {.sched_priority = PRIORITY};
    int32_t none = 0;
    int latency = open("/dev/cpu_dma_latency", O_WRONLY); /* stays open to the end */
    if (mlockall(MCL_CURRENT | MCL_FUTURE) < 0 || sched_setscheduler(0, SCHED_FIFO, &priority) < 0 || latency < 0
        || write(latency, &none, sizeof none) < 0)
        perror("modbus_client: not in real time");
}

int main(int argc, char **argv)
{
    if (argc != 6)
        return 2;
    int rtu = strcmp(argv[1], "rtu") == 0;
    modbus_t *link = rtu ? modbus_new_rtu(argv[2], atoi(argv[3]), 'N', 8, 1) : modbus_new_tcp(argv[2], atoi(argv[3]));
    long count = atol(argv[4]);
    int64_t period = atol(argv[5]) * INT64_C(1000), *took = calloc((size_t)count, sizeof *took);
    if (link == NULL || took == NULL || modbus_set_slave(link, UNIT) < 0 || modbus_connect(link) < 0)
        return 1;
    if (period)
        be_real_time();
    int64_t begun = now_ns();
    for (long k = -WARM_UP; k < count; k++) {
        begun = period ? sleep_until_next(begun, period) : wait_silence(rtu ? SILENCE_NS : 0);
        if (exchange(link) < 0) {
            fprintf(stderr, "modbus_client: %s\n", modbus_strerror(errno));
            return 1;
        }
        if (k >= 0)
            took[k] = now_ns() - begun;
    }
    for (long k = 0; k < count; k++)
        printf("%lld\n", (long long)took[k]);
    modbus_close(link);
    return 0;
}
