#include "message.h"

#include <math.h>
#include <string.h>

void message_begin(Message *m, const char *text)
{
    m->length = 0;
    m->text[0] = '\0';
    message_add(m, text);
}

void message_add(Message *m, const char *text)
{
    while (*text && m->length + 1 < (int)sizeof m->text)
        m->text[m->length++] = *text++;
    m->text[m->length] = '\0';
}

static void add_integer(Message *m, long value, int digits)
{
    char reversed[24], forward[24];
    int n = 0;
    do {
        reversed[n++] = (char)('0' + value % 10);
        value /= 10;
    } while (value > 0 || n < digits);
    for (int i = 0; i < n; i++)
        forward[i] = reversed[n - 1 - i];
    forward[n] = '\0';
    message_add(m, forward);
}

void message_add_number(Message *m, double value)
{
    if (value != value) {
        message_add(m, "NaN");
        return;
    }
    if (value < 0) {
        message_add(m, "-");
        value = -value;
    }
    if (value == 0 || isinf(value)) {
        message_add(m, value == 0 ? "0" : "infinity");
        return;
    }
    /* Compute six significant digits as an integer, and the exponent of the first digit. */
    int exponent = (int)floor(log10(value));
    /* The power of ten has two factors. A single factor would overflow for the smallest numbers. */
    long scaled =
        lround(value * pow(10.0, -(exponent / 2)) * pow(10.0, 5 - (exponent - exponent / 2)));
    if (scaled > 999999) {
        scaled /= 10;
        exponent++;
    }
    /* Write the digits as d.ddddd or 0.00ddd, without trailing zeros. Write the exponent only if it
       is below -4 or above 5. */
    int shown = exponent < -4 || exponent > 5 ? 0 : exponent;
    int decimals = 5 - shown;
    while (decimals > 0 && scaled % 10 == 0) {
        scaled /= 10;
        decimals--;
    }
    long unit = 1;
    for (int i = 0; i < decimals; i++)
        unit *= 10;
    add_integer(m, scaled / unit, 1);
    if (decimals > 0) {
        message_add(m, ".");
        add_integer(m, scaled % unit, decimals);
    }
    if (shown != exponent) {
        message_add(m, exponent < 0 ? "e-" : "e+");
        add_integer(m, exponent < 0 ? -exponent : exponent, 2);
    }
}
