/* One to four three-axis Hall sensors MLX90393: 100 rounds per second, x, y, z of each in mT, NaN where one does not
   answer. Gain, resolution and conversion time are those of a public driver; nobody has run this on hardware yet. */
#include <Wire.h>
#include <math.h>

#include "frame_encoder.h"

enum {
    SENSORS = 4,
    FIRST_ADDRESS = 0x0C, /* and the next three: by the pins A0 and A1 of the sensor */
    XYZ = 0x0E,           /* which axes a command is about */
    REFUSED = 0x10, WAS_RESET = 0x04 /* bits of the status, the first byte of every answer */
};
static const uint32_t BAUD = 500000, PERIOD_US = 10000;
static const uint32_t CONVERSION_US = 2453; /* 2230 us with these settings, and 10 % more */
/* mT per count at the smallest gain, 16 of 17 bits, so that its whole range of 50 mT fits */
static const float MT_XY = 1.502e-3f, MT_Z = 2.420e-3f;

static bool configured[SENSORS];
static float values[3 * SENSORS];
static uint8_t frame[LONGEST_FRAME];
static uint32_t sequence, next_us;

/* Give a command, read the status and what follows; return whether a sensor that was not reset accepted it. */
static bool command(uint8_t sensor, const uint8_t *bytes, uint8_t n, uint8_t *answer, uint8_t n_answer)
{
    const uint8_t address = FIRST_ADDRESS + sensor;
    Wire.beginTransmission(address);
    Wire.write(bytes, n);
    if (Wire.endTransmission(false) != 0 || Wire.requestFrom(address, n_answer) != n_answer) return false;
    for (uint8_t i = 0; i < n_answer; i++) answer[i] = Wire.read();
    return !(answer[0] & (REFUSED | WAS_RESET));
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
    return (configured[sensor] || configure(sensor)) && command(sensor, single, 1, &status, 1);
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

void setup()
{
    Serial.begin(BAUD);
    Wire.begin();
    Wire.setClock(400000);
#ifdef WIRE_HAS_TIMEOUT
    Wire.setWireTimeout(3000, true); /* a sensor that holds the bus must not stop the others for ever */
#endif
    next_us = micros();
}

void loop()
{
    while ((int32_t)(micros() - next_us) < 0) {}
    const uint32_t time_us = micros();
    next_us += PERIOD_US;
    if ((int32_t)(time_us - next_us) > 0) next_us = time_us; /* more than a round behind: begin anew */

    for (uint8_t s = 0; s < SENSORS; s++) configured[s] = start_conversion(s);
    const uint32_t started_us = micros();
    while (micros() - started_us < CONVERSION_US) {}
    for (uint8_t s = 0; s < SENSORS; s++) {
        configured[s] = configured[s] && read_field(s, values + 3 * s);
        if (!configured[s]) values[3 * s] = values[3 * s + 1] = values[3 * s + 2] = NAN;
    }
    Serial.write(frame, encode_frame(frame, 0, FLOAT32, values, 3 * SENSORS, sequence++, time_us));
}
