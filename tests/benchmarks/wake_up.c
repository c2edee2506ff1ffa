/* Reference for the loop's pacer: waits for one absolute deadline per period and prints the latency
   of each wake-up [ns]. */
#define _GNU_SOURCE
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <time.h>

int main(int count_of_arguments, char **arguments)
{
    long count = count_of_arguments > 1 ? atol(arguments[1]) : 1000,
         *late = malloc((size_t)count * sizeof *late);
    struct sched_param priority = {.sched_priority = 40};
    struct timespec deadline, now;
    int real_time = sched_setscheduler(0, SCHED_FIFO, &priority) == 0;
    prctl(PR_SET_TIMERSLACK, 1UL);
    mlockall(MCL_CURRENT | MCL_FUTURE);
    clock_gettime(CLOCK_MONOTONIC, &deadline);
    for (long i = 0; i < count; i++) {
        deadline.tv_nsec += 1000000;
        if (deadline.tv_nsec >= 1000000000) {
            deadline.tv_nsec -= 1000000000;
            deadline.tv_sec++;
        }
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &deadline, NULL);
        clock_gettime(CLOCK_MONOTONIC, &now);
        late[i] = (now.tv_sec - deadline.tv_sec) * 1000000000L + now.tv_nsec - deadline.tv_nsec;
    }
    fprintf(stderr, "real time: %d\n", real_time);
    for (long i = 0; i < count; i++)
        printf("%ld\n", late[i]);
    return 0;
}
