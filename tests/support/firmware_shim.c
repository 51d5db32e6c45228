/* What a simulation has to know of the reference firmware beyond what a board needs. */
#include "hapticd_board.h"

const size_t hapticd_board_bytes = sizeof(struct hapticd_board);

/* Whether an IN is to be latched, and when the next one is. */
bool hapticd_latch_due(const struct hapticd_board *board, uint32_t *due_us)
{
    *due_us = board->latch_us[board->latch_oldest];
    return board->latches;
}

/* Board time is not 0 now but this. */
void hapticd_begin_at(struct hapticd_board *board, uint32_t board_time_us)
{
    board->origin_us -= board_time_us;
}
