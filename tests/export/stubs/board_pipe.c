/* A board for the tests: each period it reads (milliseconds to be busy, 1 if measured, 1 if armed, inputs) from stdin, and writes
 * (status, sample, 1 if commanded, command) and how often the watchdog was fed, as doubles. At the end of stdin it ends the program.
 */
#include "board.h"
#include "busy.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static double row[3 + sizeof(surctl_closed_form_input_t) / sizeof(double)];
static double commanded[5];
static double fed;

uint32_t board_wait(void) { return 1u; }

int board_measure(surctl_closed_form_input_t *input)
{
    double inputs[ROW];
    if ((fread(row, sizeof row[0], 3, stdin) != 3) || (fread(inputs, sizeof inputs, 1, stdin) != 1)) { exit(0); }
    if (row[1] != 0.0) { memcpy(input, inputs, sizeof inputs); }
    BUSY(row[0]);
    return row[1] != 0.0;
}

void board_actuate(const surctl_closed_form_output_t *output)
{
    memset(commanded, 0, sizeof commanded);
    if (output != NULL) {
        commanded[0] = 1.0;
        memcpy(commanded + 1, output->tau, sizeof output->tau);
    }
}

int board_armed(void) { return row[2] != 0.0; }

void board_log(const surctl_closed_form_loop_t *loop)
{
    const double told[2] = { loop->status, loop->input.sample };
    (void)fwrite(told, sizeof told, 1, stdout);
    (void)fwrite(commanded, sizeof commanded, 1, stdout);
    (void)fwrite(&fed, sizeof fed, 1, stdout);
    (void)fflush(stdout);
}

void board_alive(void) { fed += 1.0; }

size_t board_stored(unsigned char *bytes, size_t room)
{
    bytes[0] = 0;
    return (room > 5u) ? 5u : 0u;
}

void board_gains(int result) { (void)fprintf(stderr, "gains %d", result); }
