/* The two-wire interface of the ATmega328P by its registers (datasheet, section "TWI"). SDA is PC4, SCL is PC5. */
#ifdef __AVR__
#include "twi.h"

#include <avr/io.h>
#include <stdbool.h>
#include <util/delay.h>

enum {
    /* Turns of a waiting loop, of about half a microsecond: a clock would cost more than the bus itself. */
    LONGEST = 4000, /* of one byte: a BNO055 may hold the clock, but not so long */
    RISE = 40,      /* until a line that was let go is high */
    STARTED = 0x08, RESTARTED = 0x10,
    WRITE_TAKEN = 0x18, WRITE_REFUSED = 0x20, BYTE_TAKEN = 0x28, BYTE_REFUSED = 0x30,
    READ_TAKEN = 0x40, READ_REFUSED = 0x48, BYTE_CAME = 0x50, LAST_CAME = 0x58
};

uint16_t twi_recoveries;

static bool lines_are_high(void)
{
    const uint8_t both = _BV(PINC4) | _BV(PINC5);
    for (uint8_t turns = 0; turns < RISE; turns++)
        if ((PINC & both) == both) return true;
    return false;
}

/* A slave that was cut off in the middle of a byte holds SDA until it has got the rest of its clock pulses. */
static void recover(void)
{
    const uint8_t sda = _BV(DDC4), scl = _BV(DDC5);
    twi_recoveries++;
    TWCR = 0;                        /* the pins are ours: low by DDR, high by the pull-up */
    PORTC &= (uint8_t)~(sda | scl);
    for (uint8_t i = 0; i < 9 && !(PINC & _BV(PINC4)); i++) {
        DDRC |= scl;
        _delay_us(5);
        DDRC &= (uint8_t)~scl;
        _delay_us(5);
    }
    DDRC |= sda;                     /* a stop: SDA rises while SCL is high */
    _delay_us(5);
    DDRC &= (uint8_t)~sda;
    _delay_us(5);
    TWCR = _BV(TWEN);
}

/* One start, or one byte; return the status, or 0xFF after LONGEST. */
static uint8_t step(uint8_t control)
{
    TWCR = (uint8_t)(_BV(TWINT) | _BV(TWEN) | control);
    for (uint16_t turns = 0; turns < LONGEST; turns++)
        if (TWCR & _BV(TWINT)) return TWSR & 0xF8;
    return 0xFF;
}

static uint8_t write_byte(uint8_t byte)
{
    TWDR = byte;
    return step(0);
}

static uint8_t exchange(uint8_t address, const uint8_t *out, uint8_t n_out, uint8_t *in, uint8_t n_in)
{
    uint8_t status = step(_BV(TWSTA));
    if (status != STARTED) return TWI_STUCK;
    if (n_out > 0) {
        status = write_byte((uint8_t)(address << 1));
        for (; status == WRITE_TAKEN || status == BYTE_TAKEN; out++, n_out--) {
            if (n_out == 0) break;
            status = write_byte(*out);
        }
        if (status == WRITE_REFUSED || status == BYTE_REFUSED) return TWI_NO_ANSWER;
        if (status != BYTE_TAKEN) return TWI_STUCK;
        if (n_in > 0 && step(_BV(TWSTA)) != RESTARTED) return TWI_STUCK;
    }
    if (n_in > 0) {
        status = write_byte((uint8_t)(address << 1 | 1));
        if (status == READ_REFUSED) return TWI_NO_ANSWER;
        if (status != READ_TAKEN) return TWI_STUCK;
        for (; n_in > 0; n_in--) {
            status = step(n_in > 1 ? _BV(TWEA) : 0);
            if (status != (n_in > 1 ? BYTE_CAME : LAST_CAME)) return TWI_STUCK;
            *in++ = TWDR;
        }
    }
    return TWI_OK;
}

void twi_begin(void)
{
    TWSR = 0; /* prescaler 1 */
    TWBR = (uint8_t)((F_CPU / 400000 - 16) / 2);
    TWCR = _BV(TWEN);
}

uint8_t twi_transfer(uint8_t address, const uint8_t *out, uint8_t n_out, uint8_t *in, uint8_t n_in)
{
    if (!lines_are_high()) {
        recover();
        if (!lines_are_high()) return TWI_STUCK;
    }
    const uint8_t result = exchange(address, out, n_out, in, n_in);
    if (result == TWI_STUCK) {
        recover();
        return TWI_STUCK;
    }
    TWCR = _BV(TWINT) | _BV(TWEN) | _BV(TWSTO);
    for (uint8_t turns = 0; turns < RISE && TWCR & _BV(TWSTO); turns++) {}
    /* A held SDA reads as zeros and as acknowledged: the stop shows it. */
    if (!lines_are_high()) {
        recover();
        return TWI_STUCK;
    }
    return result;
}
#endif
