/* One to four three-axis Hall sensors MLX90393: stream 0, 200 rounds per second, x, y, z of each in mT.
   C99, and a sketch. The page "Firmware" of the book has the wiring. */
#include <board.h>
#include <math.h>
#include <rounds.h>
#include <twi.h>

enum {
    SENSORS = 4,          /* at 0x0C to 0x0F: by A0 and A1 */
    FIRST_ADDRESS = 0x0C,
    XYZ = 0x0E,           /* which axes a command is about */
    CONVERSION_US = 2453, /* 2230 us with these settings, and 10 % more */
    REFUSED = 0x10, WAS_RESET = 0x04 /* bits of the status, the first byte of every answer */
};
static const uint32_t BAUD = 500000, PERIOD_US = 5000;
/* mT per count at the smallest gain, 16 of 17 bits, so that its whole range of 50 mT fits */
static const float MT_XY = 1.502e-3f, MT_Z = 2.420e-3f;

static bool configured[SENSORS];
static float values[3 * SENSORS];

/* Give a command, read the status and what follows; return whether it was accepted by a sensor that was not reset. */
static bool command(uint8_t sensor, const uint8_t *bytes, uint8_t n, uint8_t *answer, uint8_t n_answer)
{
    const uint8_t address = (uint8_t)(FIRST_ADDRESS + sensor);
    return twi_transfer(address, bytes, n, answer, n_answer) == TWI_OK && !(answer[0] & (REFUSED | WAS_RESET));
}

static bool configure(uint8_t sensor)
{
    static const uint8_t leave[1] = { 0x80 };
    static const uint8_t gain[4] = { 0x60, 0x00, 0x0C, 0x00 << 2 };    /* register 0: GAIN_SEL 0, HALLCONF 12 */
    static const uint8_t filters[4] = { 0x60, 0x02, 0xA5, 0x02 << 2 }; /* register 2: RES 1, DIG_FILT 1, OSR 1 */
    uint8_t status;
    command(sensor, leave, 1, &status, 1); /* it may say that it was reset: no more after that */
    return command(sensor, gain, 4, &status, 1) && command(sensor, filters, 4, &status, 1);
}

static bool start_conversion(uint8_t sensor)
{
    static const uint8_t single[1] = { 0x30 | XYZ };
    uint8_t status;
    if (!configured[sensor]) configured[sensor] = configure(sensor);
    if (configured[sensor]) configured[sensor] = command(sensor, single, 1, &status, 1);
    return configured[sensor];
}

static bool read_field(uint8_t sensor, float *mt)
{
    static const uint8_t measurement[1] = { 0x40 | XYZ };
    uint8_t bytes[7];
    if (!command(sensor, measurement, 1, bytes, 7)) return false;
    for (uint8_t i = 0; i < 3; i++)
        mt[i] = (i < 2 ? MT_XY : MT_Z) * (int16_t)((uint16_t)bytes[1 + 2 * i] << 8 | bytes[2 + 2 * i]);
    return true;
}

void setup(void) { rounds_begin(BAUD, PERIOD_US, SENSORS); }

void loop(void)
{
    static round_t before;
    const round_t now = next_round();
    bool started[SENSORS];
    uint32_t ready_us = 0;
    for (uint8_t s = 0; s < SENSORS; s++) started[s] = start_conversion(s);
    ready_us = board_micros() + CONVERSION_US;
    /* While all convert. */
    if (now.number > 0) send_readings(0, values, 3 * SENSORS, before);
    send_status_when_due();
    board_wait_until(ready_us);
    for (uint8_t s = 0; s < SENSORS; s++) {
        configured[s] = started[s] && read_field(s, values + 3 * s);
        if (configured[s]) continue;
        values[3 * s] = values[3 * s + 1] = values[3 * s + 2] = NAN;
        count_missing(s);
    }
    before = now;
}
