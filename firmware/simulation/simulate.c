/* An ATmega328P under simavr with simulated sensors on its I2C bus and its UART on a pseudo-terminal.

   simulate FIRMWARE.elf READINGS.txt PORT SECONDS SPEED [EVENT@SECONDS ...]

   READINGS.txt  a line for each change: time [us], then for every sensor what it reads (see slaves below), for ever
                 the last line; PORT  a symbolic link to be made; SPEED  1 is real time, 0 as fast as possible.
   EVENT         unplug:ADDRESS[.BRANCH], plug:..., stick (SDA held until seven clock pulses came), hold[:BRANCH]
                 (SDA held until let-go), let-go, brown-out.

   It begins when a reader has opened the port, or at once if PORT is "-" (bytes then go to standard output). Bytes are
   handed on as they come; a reader that is too slow stops the simulated time, and nothing is lost (of the class of
   buserror/simavr#270, which is about the example that queues them). The two-wire interface is our own model on
   simavr's registers: simavr's knows no held line and takes no time for the address of a write. */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_cycle_timers.h>
#include <simavr/sim_elf.h>

enum { TWBR = 0xB8, TWSR = 0xB9, TWDR = 0xBB, TWCR = 0xBC, PINC = 0x26, DDRC = 0x27, PORTC = 0x28, PORTD = 0x2B,
       MCUSR = 0x54, TWINT = 0x80, TWEA = 0x40, TWSTA = 0x20, TWSTO = 0x10, TWEN = 0x04, SDA = 1 << 4, SCL = 1 << 5,
       MOST_VALUES = 64, MOST_SLAVES = 24, MHZ = 16 };

static avr_t *avr;
static double readings[MOST_VALUES]; /* now */

/* ---- sensors: each reads its own part of a line ------------------------------------------------------------------ */

typedef struct slave {
    uint8_t address;
    int branch; /* of the multiplexer, -1: on the bus itself */
    const double *reads;
    bool absent;
    uint8_t registers[256], pointer, reply[10], reply_at;
    int received; /* bytes since it was addressed */
    avr_cycle_count_t ready;
    int16_t converting, converted[3];
    void (*addressed)(struct slave *, bool to_read);
    bool (*take)(struct slave *, uint8_t);
    uint8_t (*give)(struct slave *);
    void (*power_on)(struct slave *);
} slave_t;

static slave_t slaves[MOST_SLAVES];
static int slave_count;
static uint8_t branches; /* selected */

static int16_t rounded(double x)
{
    return (int16_t)(x < -32768 ? -32768 : x > 32767 ? 32767 : x < 0 ? x - 0.5 : x + 0.5);
}

static avr_cycle_count_t after_us(double us) { return avr->cycle + (avr_cycle_count_t)(us * MHZ); }

/* ADS1115: four voltages [mV]. A conversion takes 10 % longer than its data rate says, as the datasheet allows. */
static void ads_power_on(slave_t *s)
{
    memset(s->registers, 0, 8);
    s->registers[2] = 0x85; s->registers[3] = 0x83; /* two bytes for each register */
    s->ready = 0;
}
static void ads_addressed(slave_t *s, bool to_read) { s->received = 0; s->reply_at = 0; (void)to_read; }
static bool ads_take(slave_t *s, uint8_t byte)
{
    static const double full_mv[8] = { 6144, 4096, 2048, 1024, 512, 256, 256, 256 };
    static const double per_second[8] = { 8, 16, 32, 64, 128, 250, 475, 860 };
    if (s->received++ == 0) s->pointer = byte & 3;
    else if (s->received <= 3) s->registers[2 * s->pointer + s->received - 2] = byte;
    if (s->received == 3 && s->pointer == 1 && s->registers[2] & 0x80 && avr->cycle >= s->ready) {
        const int mux = s->registers[2] >> 4 & 7, gain = s->registers[2] >> 1 & 7;
        s->converting = rounded((mux < 4 ? 0 : s->reads[mux - 4]) * 32768 / full_mv[gain]);
        s->ready = after_us(1.1e6 / per_second[s->registers[3] >> 5] + 25);
    }
    return true;
}
static uint8_t ads_give(slave_t *s)
{
    if (avr->cycle >= s->ready && s->ready) {
        s->registers[0] = (uint8_t)((uint16_t)s->converting >> 8);
        s->registers[1] = (uint8_t)s->converting;
        s->ready = 0;
    }
    return s->registers[2 * s->pointer + (s->reply_at++ & 1)];
}

/* MLX90393: the field along x, y and z [uT]. */
static void mlx_power_on(slave_t *s)
{
    memset(s->registers, 0, sizeof s->registers);
    s->registers[0] = 0x04; /* the status: was reset */
    s->ready = 0;
}
static void mlx_addressed(slave_t *s, bool to_read) { s->received = 0; s->reply_at = 0; (void)to_read; }
static bool mlx_take(slave_t *s, uint8_t byte)
{
    /* x and y at gain 0 to 7; z is 1.6113 times that. Conversion times [us] by filter and oversampling. */
    static const double ut[8] = { 0.751, 0.601, 0.451, 0.376, 0.300, 0.250, 0.200, 0.150 };
    static const double zt[8] = { 1.210, 0.968, 0.726, 0.605, 0.484, 0.403, 0.323, 0.242 };
    static const double us[4][4] = { { 1270, 1840, 3000, 5300 }, { 1460, 2230, 3760, 6840 },
        { 1840, 3000, 5300, 9910 }, { 2610, 4530, 8370, 16050 } };
    uint8_t *memory = s->registers + 16;
    s->registers[1 + s->received] = byte;
    s->received++;
    const uint8_t command = s->registers[1] & 0xF0;
    const bool busy = avr->cycle < s->ready;
    if (command == 0x60 && s->received == 4) {
        memory[2 * (byte >> 2)] = s->registers[2];
        memory[2 * (byte >> 2) + 1] = s->registers[3];
        s->reply[0] = busy ? 0x10 : 0;
    }
    if (command == 0x30 && s->received == 1) {
        const unsigned gain = memory[1] >> 4 & 7, set = (unsigned)memory[4] << 8 | memory[5];
        for (int i = 0; i < 3; i++) {
            const double lsb = (i < 2 ? ut : zt)[gain] * (1 << (set >> (5 + 2 * i) & 3));
            s->converted[i] = rounded(s->reads[i] / lsb);
        }
        s->reply[0] = 0x20;
        s->ready = after_us(us[set >> 2 & 3][set & 3]);
    }
    if (command == 0x40 && s->received == 1) {
        s->reply[0] = busy || s->ready == 0 ? 0x10 : 0;
        for (int i = 0; i < 3; i++) {
            s->reply[1 + 2 * i] = (uint8_t)((uint16_t)s->converted[i] >> 8);
            s->reply[2 + 2 * i] = (uint8_t)s->converted[i];
        }
        if (!busy) s->ready = 0;
    }
    if (s->received == 1) { /* the first status after a reset says so */
        s->reply[0] |= s->registers[0];
        s->registers[0] = 0;
    }
    return true;
}
static uint8_t mlx_give(slave_t *s) { return s->reply[s->reply_at < 9 ? s->reply_at++ : 9]; }

/* BNO055: its quaternion w, x, y, z. */
static void bno_power_on(slave_t *s)
{
    memset(s->registers, 0, sizeof s->registers);
    s->registers[0] = 0xA0;
    s->ready = after_us(650e3); /* it does not answer before */
}
static void bno_addressed(slave_t *s, bool to_read)
{
    s->received = 0;
    if (!to_read) return;
    for (int i = 0; i < 4; i++) {
        const int16_t count = s->registers[0x3D] && avr->cycle >= s->ready ? rounded(s->reads[i] * 16384) : 0;
        s->registers[0x20 + 2 * i] = (uint8_t)count;
        s->registers[0x21 + 2 * i] = (uint8_t)((uint16_t)count >> 8);
    }
}
static bool bno_take(slave_t *s, uint8_t byte)
{
    if (s->received++ == 0) s->pointer = byte;
    else {
        if (s->pointer == 0x3D && s->registers[0x3D] != byte) s->ready = after_us(7e3);
        s->registers[s->pointer++] = byte;
    }
    return true;
}
static uint8_t bno_give(slave_t *s) { return s->registers[s->pointer++]; }

/* TCA9548A: one bit for each branch. */
static void tca_power_on(slave_t *s) { branches = 0; (void)s; }
static void tca_addressed(slave_t *s, bool to_read) { (void)s; (void)to_read; }
static bool tca_take(slave_t *s, uint8_t byte) { branches = byte; (void)s; return true; }
static uint8_t tca_give(slave_t *s) { (void)s; return branches; }

static void add(uint8_t address, int branch, int first, char kind)
{
    slave_t *s = &slaves[slave_count++];
    *s = (slave_t){ .address = address, .branch = branch, .reads = readings + first };
#define ARE(k) s->addressed = k##_addressed, s->take = k##_take, s->give = k##_give, s->power_on = k##_power_on
    if (kind == 'a') ARE(ads); else if (kind == 'm') ARE(mlx); else if (kind == 'b') ARE(bno); else ARE(tca);
    s->power_on(s);
    if (kind == 'b') s->ready = 0; /* powered long before */
}

/* ---- the bus ------------------------------------------------------------------------------------------------------ */

static slave_t *spoken_to;
static bool owned, addressing, reading, pending_stop;
static uint8_t pending_status;
static int pulses_to_free;    /* a slave holds SDA until it got so many */
static bool held;             /* SDA is held */
static int held_branch = -1;  /* if only there */
static avr_io_write_t ddr_write, portd_write;
static void *ddr_param, *portd_param;

static bool sda_held(void)
{
    return pulses_to_free > 0 || (held && (held_branch < 0 || branches & 1 << held_branch));
}

static avr_cycle_count_t complete(avr_t *a, avr_cycle_count_t when, void *param)
{
    (void)param;
    if (pending_stop) {
        if (sda_held()) return when + 160; /* SDA cannot rise: there is no stop */
        a->data[TWCR] &= (uint8_t)~TWSTO;
        pending_stop = false;
        return 0;
    }
    if ((pending_status == 0x08 || pending_status == 0x10) && sda_held()) return when + 160; /* nor a start */
    a->data[TWSR] = pending_status;
    a->data[TWCR] |= TWINT;
    return 0;
}

static slave_t *answering(uint8_t address)
{
    for (slave_t *s = slaves; s < slaves + slave_count; s++)
        if (s->address == address && !s->absent && (s->branch < 0 || branches & 1 << s->branch)
            && !(s->power_on == bno_power_on && s->registers[0x3D] == 0 && avr->cycle < s->ready))
            return s;
    return NULL;
}

static void control_written(avr_t *a, avr_io_addr_t at, uint8_t value, void *param)
{
    (void)param;
    const unsigned bit = 16 + 2u * a->data[TWBR]; /* cycles; the prescaler is 1 */
    unsigned bits = 9;
    a->data[at] = value & (uint8_t)~TWINT;
    if (!(value & TWEN)) {
        avr_cycle_timer_cancel(a, complete, NULL);
        owned = pending_stop = false;
        return;
    }
    if (!(value & TWINT)) return;
    if (value & TWSTO) {
        owned = false;
        pending_stop = true;
        bits = 1;
    } else if (value & TWSTA) {
        pending_status = owned ? 0x10 : 0x08;
        owned = addressing = true;
        bits = 1;
    } else if (addressing) {
        addressing = false;
        reading = a->data[TWDR] & 1;
        spoken_to = answering(a->data[TWDR] >> 1);
        if (spoken_to) spoken_to->addressed(spoken_to, reading);
        const bool yes = spoken_to || sda_held();
        pending_status = reading ? (yes ? 0x40 : 0x48) : (yes ? 0x18 : 0x20);
    } else if (reading) {
        a->data[TWDR] = sda_held() ? 0 : spoken_to && !spoken_to->absent ? spoken_to->give(spoken_to) : 0xFF;
        pending_status = value & TWEA ? 0x50 : 0x58;
    } else {
        const bool yes = spoken_to && !spoken_to->absent && spoken_to->take(spoken_to, a->data[TWDR]);
        pending_status = yes || sda_held() ? 0x28 : 0x30;
    }
    avr_cycle_timer_cancel(a, complete, NULL);
    avr_cycle_timer_register(a, (avr_cycle_count_t)bits * bit, complete, NULL);
}

static uint8_t status_read(avr_t *a, avr_io_addr_t at, void *param) { (void)param; return a->data[at]; }
static void plain_write(avr_t *a, avr_io_addr_t at, uint8_t v, void *param) { (void)param; a->data[at] = v; }

static uint8_t pins_read(avr_t *a, avr_io_addr_t at, void *param)
{
    (void)param;
    const uint8_t low = a->data[DDRC] & (uint8_t)~a->data[PORTC];
    uint8_t pins = (uint8_t)~low;
    if (sda_held()) pins &= (uint8_t)~SDA;
    return a->data[at] = pins;
}

static void ddr_written(avr_t *a, avr_io_addr_t at, uint8_t value, void *param)
{
    (void)param;
    const bool fell = (value & ~a->data[DDRC] & SCL) != 0;
    if (fell && pulses_to_free > 0) pulses_to_free--;
    if (ddr_write) ddr_write(a, at, value, ddr_param); else a->data[at] = value;
}

static void portd_written(avr_t *a, avr_io_addr_t at, uint8_t value, void *param)
{
    (void)param;
    if (a->data[PORTD] & ~value & 1 << 4) branches = 0; /* the reset pin of the multiplexer */
    if (portd_write) portd_write(a, at, value, portd_param); else a->data[at] = value;
}

static void hook(uint8_t at, avr_io_read_t read, avr_io_write_t write)
{
    if (read) { avr->io[AVR_DATA_TO_IO(at)].r.c = read; avr->io[AVR_DATA_TO_IO(at)].r.param = NULL; }
    if (write) { avr->io[AVR_DATA_TO_IO(at)].w.c = write; avr->io[AVR_DATA_TO_IO(at)].w.param = NULL; }
}

/* ---- the rest ------------------------------------------------------------------------------------------------------ */

static int out = 1;
static uint8_t sent[4096];
static size_t sent_count;

static void flush_sent(void)
{
    for (size_t at = 0; at < sent_count;) {
        const ssize_t n = write(out, sent + at, sent_count - at);
        if (n > 0) at += (size_t)n;
        else if (errno != EINTR && errno != EAGAIN) { perror("simulate: the port"); exit(1); }
    }
    sent_count = 0;
}

static void byte_sent(struct avr_irq_t *irq, uint32_t value, void *param)
{
    (void)irq; (void)param;
    sent[sent_count++] = (uint8_t)value;
    if (sent_count == sizeof sent) flush_sent();
}

typedef struct { double s; char what[32]; } event_t;

static void happen(const char *what)
{
    unsigned address;
    int branch = -1;
    if (!strcmp(what, "stick")) pulses_to_free = 7;
    else if (sscanf(what, "hold:%d", &held_branch) == 1 || !strcmp(what, "hold")) held = true;
    else if (!strcmp(what, "let-go")) { held = false; held_branch = -1; }
    else if (!strcmp(what, "brown-out")) {
        avr_reset(avr);
        avr->data[MCUSR] = 4;
        avr_cycle_timer_cancel(avr, complete, NULL);
        owned = pending_stop = false;
    } else if (sscanf(what, "unplug:%x.%d", &address, &branch) >= 1 || sscanf(what, "plug:%x.%d", &address, &branch) >= 1) {
        for (slave_t *s = slaves; s < slaves + slave_count; s++)
            if (s->address == address && s->branch == branch) {
                s->absent = what[0] == 'u';
                if (!s->absent) s->power_on(s);
            }
    } else { fprintf(stderr, "simulate: no such event: %s\n", what); exit(2); }
    fprintf(stderr, "%.6f %s\n", (double)avr->cycle / (1e6 * MHZ), what);
}

static bool next_line(FILE *file, double *us, double *values)
{
    char line[2048], *at = line;
    int n;
    if (!fgets(line, sizeof line, file)) return false;
    *us = strtod(line, &at);
    for (n = 0; n < MOST_VALUES; n++) {
        char *end;
        values[n] = strtod(at, &end);
        if (end == at) break;
        at = end;
    }
    return true;
}

static int open_port(const char *link)
{
    const int master = posix_openpt(O_RDWR | O_NOCTTY);
    if (master < 0 || grantpt(master) || unlockpt(master)) { perror("simulate: pseudo-terminal"); exit(1); }
    const int kept_open = open(ptsname(master), O_RDWR | O_NOCTTY); /* a reader may come and go */
    struct termios now;
    unlink(link);
    if (kept_open < 0 || symlink(ptsname(master), link)) { perror("simulate: the link"); exit(1); }
    do usleep(10000); while (!tcgetattr(kept_open, &now) && now.c_lflag & ICANON); /* until a reader made it raw */
    usleep(100000);
    return master;
}

int main(int argc, char **argv)
{
    if (argc < 6) { fprintf(stderr, "simulate FIRMWARE.elf READINGS.txt PORT SECONDS SPEED [EVENT@SECONDS ...]\n"); return 2; }
    const double seconds = atof(argv[4]), speed = atof(argv[5]);
    event_t events[64];
    int event_count = 0, event_at = 0;
    for (int i = 6; i < argc && event_count < 64; i++, event_count++)
        if (sscanf(argv[i], "%31[^@]@%lf", events[event_count].what, &events[event_count].s) != 2) return 2;

    elf_firmware_t firmware = { 0 };
    if (elf_read_firmware(argv[1], &firmware)) { fprintf(stderr, "simulate: cannot read %s\n", argv[1]); return 1; }
    avr = avr_make_mcu_by_name("atmega328p");
    avr_init(avr);
    avr->log = LOG_ERROR;
    firmware.frequency = MHZ * 1000000;
    avr_load_firmware(avr, &firmware);
    avr->data[MCUSR] = 1;
    FILE *file = fopen(argv[2], "r");
    if (!file) { perror(argv[2]); return 1; }
    for (int i = 0; i < 3; i++) add((uint8_t)(0x48 + i), -1, 4 * i, 'a');
    for (int i = 0; i < 4; i++) add((uint8_t)(0x0C + i), -1, 12 + 3 * i, 'm');
    add(0x70, -1, 0, 't');
    for (int i = 0; i < 8; i++) add(0x28, i, 24 + 4 * i, 'b');

    hook(TWBR, NULL, plain_write); hook(TWSR, status_read, plain_write); hook(TWDR, status_read, plain_write);
    hook(TWCR, status_read, control_written); hook(PINC, pins_read, NULL);
    ddr_write = avr->io[AVR_DATA_TO_IO(DDRC)].w.c; ddr_param = avr->io[AVR_DATA_TO_IO(DDRC)].w.param;
    portd_write = avr->io[AVR_DATA_TO_IO(PORTD)].w.c; portd_param = avr->io[AVR_DATA_TO_IO(PORTD)].w.param;
    hook(DDRC, NULL, ddr_written); hook(PORTD, NULL, portd_written);
    uint32_t flags = 0;
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), byte_sent, NULL);
    if (strcmp(argv[3], "-")) out = open_port(argv[3]);

    double due_us = -1, next[MOST_VALUES];
    bool more = next_line(file, &due_us, next);
    struct timespec begin, now;
    clock_gettime(CLOCK_MONOTONIC, &begin);
    avr_cycle_count_t checked = 0;
    while (avr->cycle < seconds * 1e6 * MHZ) {
        const double us = (double)avr->cycle / MHZ;
        while (more && us >= due_us) {
            memcpy(readings, next, sizeof readings);
            more = next_line(file, &due_us, next);
        }
        while (event_at < event_count && us >= 1e6 * events[event_at].s) happen(events[event_at++].what);
        const int state = avr_run(avr);
        if (state == cpu_Done || state == cpu_Crashed) { fprintf(stderr, "simulate: the program ended\n"); return 1; }
        if (avr->cycle - checked < 1000 * MHZ) continue; /* each millisecond */
        checked = avr->cycle;
        flush_sent();
        if (speed > 0) {
            clock_gettime(CLOCK_MONOTONIC, &now);
            const double ahead_us = us / speed
                - (1e6 * (double)(now.tv_sec - begin.tv_sec) + 1e-3 * (double)(now.tv_nsec - begin.tv_nsec));
            if (ahead_us > 1000) usleep((useconds_t)ahead_us);
        }
    }
    flush_sent();
    fprintf(stderr, "done\n");
    if (out != 1) getchar(); /* the port stays until standard input is closed */
    return 0;
}
