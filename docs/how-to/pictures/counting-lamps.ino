// Counting lamps for mammometry skew: 12 lamps show a counter in Gray code, 0.5 ms a count.
// Arduino Uno or Nano (ATmega328P, 16 MHz). Each lamp: pin, 220 ohm, LED, ground.
//   bit 0..5  -> pins 2..7   (PORTD 2..7)
//   bit 6..11 -> pins 8..13  (PORTB 0..5)
//   both reference lamps: 5 V, 220 ohm, LED, ground: always on.
// The pins of a port switch together; the ports follow one another within 0.2 microseconds.

const unsigned int TICK_US = 500;   // LampStrip.tick_ms
const unsigned int COUNTS = 4096;   // 2 to the power of LampStrip.bits

volatile unsigned int count = 0;

ISR(TIMER1_COMPA_vect) {
  unsigned int gray = count ^ (count >> 1);
  byte low = (PORTD & 0x03) | ((gray & 0x3F) << 2);
  byte high = (PORTB & 0xC0) | (gray >> 6);
  PORTD = low;
  PORTB = high;
  count = (count + 1) % COUNTS;
}

void setup() {
  DDRD |= 0xFC;
  DDRB |= 0x3F;
  noInterrupts();
  TCCR1A = 0;
  TCCR1B = (1 << WGM12) | (1 << CS11);  // compare match, clock / 8: 0.5 microseconds a step
  OCR1A = 2 * TICK_US - 1;
  TIMSK0 = 0;                           // no millis(): nothing else delays a count
  TIMSK1 = (1 << OCIE1A);
  interrupts();
}

void loop() {}
