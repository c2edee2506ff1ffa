/* Message of one sentence. No formatting functions of the C library are used. */
#ifndef MESSAGE_H
#define MESSAGE_H

typedef struct {
    char text[400];
    int length;
} Message;

/* Starts a new message. */
void message_begin(Message *m, const char *text);
void message_add(Message *m, const char *text);
/* Adds a number with six significant digits. */
void message_add_number(Message *m, double value);

#endif
