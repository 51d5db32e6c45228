/* The state of the reference firmware that a simulation needs beyond the interface of a board. */
#include "hapticd_board.h"

const size_t hapticd_board_bytes = sizeof(struct hapticd_board);

/* Return whether an IN is to be latched, and its time. */
bool hapticd_latch_due(const struct hapticd_board *board, uint32_t *due_us)
{
    *due_us = board->latch_us[board->latch_oldest];
    return board->latches;
}

/* Set the present board time to this value in place of 0. */
void hapticd_begin_at(struct hapticd_board *board, uint32_t board_time_us)
{
    board->origin_us -= board_time_us;
}
