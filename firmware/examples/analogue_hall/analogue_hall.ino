/* Three to nine analogue Hall sensors on one to three ADS1115: stream 0, 200 rounds per second, in mV.
   C99, and a sketch. The page "Firmware" of the book has the wiring. */
#include <board.h>
#include <math.h>
#include <rounds.h>
#include <twi.h>

enum {
    CONVERTERS = 3,   /* at 0x48, 0x49, 0x4A: ADDR to GND, VDD, SDA */
    INPUTS = 3,       /* of each: A0, A1, A2 */
    CHANNELS = CONVERTERS * INPUTS,
    FIRST_ADDRESS = 0x48,
    CONVERSION_US = 1305 /* 1/860 s, 10 % more (tolerance of the data rate), and 25 us to power up */
};
static const uint32_t BAUD = 500000, PERIOD_US = 5000;
static const float MV_PER_COUNT = 0.1875f; /* range of +-6.144 V */
static const float LEAST_MV = 100.0f;      /* below it, a Hall sensor is not there: see the pull-downs */

static float values[CHANNELS];

static bool start_conversion(uint8_t converter, uint8_t input)
{
    /* register 1: start once; this input against GND, +-6.144 V; 860 per second, no comparator */
    const uint8_t config[3] = { 1, (uint8_t)(0xC1 | input << 4), 0xE3 };
    return twi_transfer((uint8_t)(FIRST_ADDRESS + converter), config, 3, 0, 0) == TWI_OK;
}

static float conversion_mv(uint8_t converter)
{
    const uint8_t result = 0; /* register 0 */
    uint8_t bytes[2];
    if (twi_transfer((uint8_t)(FIRST_ADDRESS + converter), &result, 1, bytes, 2) != TWI_OK) return NAN;
    const float mv = MV_PER_COUNT * (int16_t)((uint16_t)bytes[0] << 8 | bytes[1]);
    return mv < LEAST_MV ? NAN : mv;
}

void setup(void) { rounds_begin(BAUD, PERIOD_US, CHANNELS); }

void loop(void)
{
    static round_t before;
    static bool started[CONVERTERS];
    static uint32_t ready_us[CONVERTERS];
    const round_t now = next_round();
    for (uint8_t input = 0; input < INPUTS; input++) {
        for (uint8_t c = 0; c < CONVERTERS; c++) {
            /* Of the input before, which for the first one is the last of the round before. */
            const uint8_t channel = (uint8_t)(c * INPUTS + (input + INPUTS - 1) % INPUTS);
            if (input > 0 || now.number > 0) {
                if (started[c]) board_wait_until(ready_us[c]);
                values[channel] = started[c] ? conversion_mv(c) : NAN;
                if (isnan(values[channel])) count_missing(channel);
            }
            started[c] = start_conversion(c, input);
            ready_us[c] = board_micros() + CONVERSION_US;
        }
        /* While all convert: encoding takes a good part of a round at this rate. */
        if (input == 0 && now.number > 0) send_readings(0, values, CHANNELS, before);
        if (input == 1) send_status_when_due();
    }
    before = now;
}
