/* The ATmega328P: an Arduino Uno or Nano, with the Arduino core or without. Uses timer 1 and the UART. */
#ifdef __AVR__
#include "board.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/delay.h>

#if F_CPU != 16000000UL
#error "timer 1 is read as a clock of 2 MHz: F_CPU must be 16 MHz"
#endif

enum { KEPT = 0x5EED };

/* Not cleared at a reset; after power was off it holds anything, and hardly two numbers that belong together. */
static struct { uint16_t resets, check; } kept __attribute__((section(".noinit")));

uint16_t board_resets;
uint8_t board_reset_cause;

static uint8_t ring[256];
static volatile uint8_t head, tail;

ISR(USART_UDRE_vect)
{
    if (head == tail) UCSR0B &= (uint8_t)~_BV(UDRIE0);
    else UDR0 = ring[tail++];
}

void board_begin(uint32_t baud)
{
    board_reset_cause = MCUSR;
    MCUSR = 0;
    if (board_reset_cause & _BV(PORF) || kept.check != (uint16_t)(kept.resets ^ KEPT)) kept.resets = 0;
    else kept.resets++;
    kept.check = kept.resets ^ KEPT;
    board_resets = kept.resets;

    TCCR1A = 0; /* the Arduino core sets it for PWM */
    TCCR1B = _BV(CS11);
    TCNT1 = 0;
    UCSR0A = _BV(U2X0); /* first: simavr looks at it only when the rate is set */
    UBRR0 = (uint16_t)((F_CPU / 8 + baud / 2) / baud - 1);
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
    UCSR0B = _BV(TXEN0);
    PORTD |= _BV(PORTD4);
    DDRD |= _BV(DDD4);
    sei();
}

/* No interrupt, so no race with one: whoever waits asks often, and 32 ms may pass between two questions. */
uint32_t board_micros(void)
{
    static uint32_t us;
    static uint16_t counted;
    const uint16_t ticks = (uint16_t)(TCNT1 - counted) & 0xFFFE;
    counted += ticks;
    us += ticks >> 1;
    return us;
}

void board_wait_until(uint32_t time_us)
{
    while ((int32_t)(board_micros() - time_us) < 0) {}
}

bool board_send(const uint8_t *bytes, size_t n)
{
    uint8_t at = head;
    if (n > (uint8_t)(tail - at - 1)) return false;
    while (n-- > 0) ring[at++] = *bytes++;
    head = at;
    UCSR0B |= _BV(UDRIE0);
    return true;
}

void board_pulse_reset(void)
{
    PORTD &= (uint8_t)~_BV(PORTD4);
    _delay_us(2);
    PORTD |= _BV(PORTD4);
}

#ifndef ARDUINO
int main(void)
{
    setup();
    for (;;) loop();
}
#endif
#endif
