/* Eight BNO055 behind a TCA9548A: streams 0 to 7, 100 rounds per second, each a unit quaternion x, y, z, w.
   C99, and a sketch. The page "Firmware" of the book has the wiring. */
#include <board.h>
#include <math.h>
#include <rounds.h>
#include <twi.h>

enum {
    IMUS = 8,
    MULTIPLEXER = 0x70, IMU = 0x28,
    OPERATION_MODE = 0x3D, QUATERNION = 0x20,
    NDOF = 0x0C /* with the magnetometer; 0x08 without, near magnets: then its heading is free */
};
static const uint32_t BAUD = 500000, PERIOD_US = 10000;
static const float ONE = 16384.0f; /* counts */

/* Read an IMU; switch one on that was just powered: it sends zeros until then. */
static uint8_t read_quaternion(uint8_t imu, float xyzw[4])
{
    static const uint8_t first = QUATERNION, mode = OPERATION_MODE, fuse[2] = { OPERATION_MODE, NDOF };
    const uint8_t branch = (uint8_t)(1 << imu);
    uint8_t bytes[8], current, result = twi_transfer(MULTIPLEXER, &branch, 1, 0, 0);
    bool zero = true;
    if (result == TWI_OK) result = twi_transfer(IMU, &first, 1, bytes, 8);
    if (result != TWI_OK) return result;
    for (uint8_t i = 0; i < 4; i++) { /* w, x, y, z as they come */
        const int16_t count = (int16_t)((uint16_t)bytes[2 * i + 1] << 8 | bytes[2 * i]);
        zero = zero && count == 0;
        xyzw[(i + 3) % 4] = count / ONE;
    }
    if (!zero) return TWI_OK;
    result = twi_transfer(IMU, &mode, 1, &current, 1);
    if (result == TWI_OK && current == 0) result = twi_transfer(IMU, fuse, 2, 0, 0);
    return result == TWI_OK ? (uint8_t)TWI_NO_ANSWER : result;
}

void setup(void) { rounds_begin(BAUD, PERIOD_US, IMUS); }

void loop(void)
{
    round_t now = next_round();
    for (uint8_t imu = 0; imu < IMUS; imu++) {
        float xyzw[4];
        now.time_us = board_micros();
        const uint8_t result = read_quaternion(imu, xyzw);
        if (result != TWI_OK) {
            xyzw[0] = xyzw[1] = xyzw[2] = xyzw[3] = NAN;
            count_missing(imu);
        }
        if (result == TWI_STUCK) board_pulse_reset(); /* cuts off a branch that holds the bus: the others go on */
        send_readings(imu, xyzw, 4, now);
    }
    send_status_when_due();
}
