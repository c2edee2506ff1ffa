/* One sentence for the user, put together without the C library's formatting. */
#ifndef MESSAGE_H
#define MESSAGE_H

typedef struct {
    char text[400];
    int length;
} Message;

/* Start a new sentence. */
void message_begin(Message *m, const char *text);
void message_add(Message *m, const char *text);
/* Six significant digits. */
void message_add_number(Message *m, double value);

#endif
