/* Sends the readings of three-axis chips on an I2C bus as frames, 100 times per second. Nobody has run this on
   hardware yet. */
#include <Wire.h>
#include <math.h>

#include "frame_encoder.h"

/* The chips: here a TMAG5273A1 and a TMAG5273B1, by the data sheet of Texas Instruments, SLYS045B (addresses, section
   8.1 for the registers, equation (10) for the scale). For other chips, change the lines up to MT_PER_COUNT. */
static const uint8_t ADDRESSES[] = {0x35, 0x22}; /* in the order of [[sensors]] in the robot file */
static const uint8_t SETUP[][2] = { /* a register, and what is written into it */
    {0x00, 0x14}, /* DEVICE_CONFIG_1: means of 32 conversions */
    {0x02, 0x70}, /* SENSOR_CONFIG_1: x, y and z */
    {0x03, 0x00}, /* SENSOR_CONFIG_2: up to 40 mT */
    {0x01, 0x02}, /* DEVICE_CONFIG_2: measure for ever */
};
static const uint8_t FIRST_RESULT = 0x12; /* X_MSB_RESULT: x, y and z from here, two bytes each */
static const bool HIGH_BYTE_FIRST = true;
static const float MT_PER_COUNT = 40.0f / 32768;

enum { CHIPS = sizeof ADDRESSES, AXES = 3, COUNT = 2 * AXES };
static const uint32_t BAUD = 115200, I2C_HZ = 400000, PERIOD_US = 10000;
static bool ready[CHIPS];
static float values[CHIPS * AXES];
static uint8_t frame[LONGEST_FRAME];
static uint32_t sequence, next_us;

static bool set_up_chip(uint8_t address)
{
    bool all = true;
    for (const uint8_t *pair : SETUP) {
        Wire.beginTransmission(address);
        Wire.write(pair[0]);
        Wire.write(pair[1]);
        all = Wire.endTransmission() == 0 && all;
    }
    return all;
}

/* Flux density in mT; NAN where the chip does not answer, or is at the end of its range. */
static void read_chip(int chip, float mt[AXES])
{
    const uint8_t address = ADDRESSES[chip];
    Wire.beginTransmission(address);
    Wire.write(FIRST_RESULT);
    const bool answers = Wire.endTransmission(false) == 0 && Wire.requestFrom(address, (uint8_t)COUNT) == COUNT;
    const bool there = answers && ready[chip];
    for (int i = 0; i < AXES; i++) {
        const uint8_t one = there ? Wire.read() : 0, two = there ? Wire.read() : 0;
        const int16_t counts = (int16_t)(HIGH_BYTE_FIRST ? one << 8 | two : two << 8 | one);
        mt[i] = there && counts > -32768 && counts < 32767 ? counts * MT_PER_COUNT : NAN;
    }
    ready[chip] = there || set_up_chip(address); /* without power it forgets; read again after a period */
}

void setup()
{
    Serial.begin(BAUD);
    Wire.begin();
    Wire.setClock(I2C_HZ);
    for (int i = 0; i < CHIPS; i++) ready[i] = set_up_chip(ADDRESSES[i]);
    next_us = micros() + PERIOD_US;
}

void loop()
{
    while ((int32_t)(micros() - next_us) < 0) {}
    const uint32_t time_us = micros();
    next_us += PERIOD_US;
    if ((int32_t)(time_us - next_us) > 0) next_us = time_us; /* more than a period behind: begin anew */
    for (int i = 0; i < CHIPS; i++) read_chip(i, values + AXES * i);
    Serial.write(frame, encode_frame(frame, 0, FLOAT32, values, CHIPS * AXES, sequence++, time_us));
}
