/* A program of somebody else: reads the robot, drives it, and says what it saw as JSON. */
#include "hilserver.h"

#include <stdio.h>
#include <stdlib.h>
#include <time.h>

static void wait_ms(long ms)
{
    struct timespec pause = {0, ms * 1000000L};
    nanosleep(&pause, NULL);
}

/* drive IMAGE INPUTS RPM CYCLES; RPM "nan" only reads */
int main(int count, char **words)
{
    const char *why = NULL;
    struct hil_inputs mine, *shared = NULL;
    struct hil_frame frame;
    double rpm = strtod(words[3], NULL);
    int cycles = atoi(words[4]), frames = 0;
    int64_t first = -1, last = -1;

    const int64_t *image = hil_attach(words[1], &why);
    if (image != NULL && !isnan(rpm))
        shared = hil_open_inputs(words[2], &mine, &why);
    if (why != NULL) {
        fprintf(stderr, "%s\n", why);
        return 1;
    }
    for (int i = 0; i < cycles; i++, wait_ms(5)) {
        if (shared != NULL) {
            mine.drive_enable = 1;
            mine.control_mode = 0;
            mine.wheel_fl_setpoint_rpm = mine.wheel_rl_setpoint_rpm = rpm;
            mine.wheel_fr_setpoint_rpm = mine.wheel_rr_setpoint_rpm = -rpm;
            hil_write(shared, &mine);
        }
        if (hil_read(image, &frame)) {
            first = first < 0 ? frame.tick : first;
            if (frame.tick < last)
                return 2;
            last = frame.tick;
            frames++;
        }
    }
    printf("{\"frames\": %d, \"first\": %lld, \"tick\": %lld, \"sequence\": %lld, ", frames,
           (long long)first, (long long)frame.tick, (long long)frame.sequence);
    printf("\"speed\": %.17g, \"asked\": %.17g, \"x\": %.17g, \"status\": %lld}\n",
           frame.values.wheel_fl_speed_rpm, frame.values.wheel_fl_setpoint_rpm,
           frame.values.pose_x_m, (long long)frame.status.wheel_fl_speed_rpm);
    return count != 5;
}
