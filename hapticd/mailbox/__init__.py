"""The mapped files between the servo and the other processes. No process waits for them.

The servo creates and owns every file in the runtime folder; the gateway and others map them.

    mailbox         header, heartbeats and counters, command ring (gateway -> servo), answer ring
                    (servo -> gateway)
    telemetry.ring  one record per tick, SPSC; kept as last.ring for the flight recorder when a
                    servo restarts
    stop            eight bytes; anything but zeros latches STOP, and the servo writes it back to
                    zeros; its group may write it, so it is read and never mapped
    perturbation    waveform in probe counts, written by the gateway while no perturbation runs
    servo.report    JSON: rights granted by the operating system, results of the board's checks

    layout       every offset, record and number of these files: State, Command, Value, Result, Flag
    files        runtime_folder; claims, maps, ordered words
    daemons      daemon_folder; possible folders of daemons, whether they are trusted and their
                 daemons alive; StopWord, press_stop
    client_side  GatewayMailbox
    servo_side   ServoMailbox

Three kinds of mailbox: every value, in order, once -> command and answer ring; every value, lossy
but counted -> telemetry; the latest value -> a word. A writer never waits: a full ring answers
busy, an unread record is overwritten.

A store of the head must not overtake the data it announces (see `files.word_access`). Readers check
magic, layout hash and epoch; the servo checks sequence, CRC and range of every command. A folder
has one servo (`files.claim` refuses others). A ring has one writer (there is one gateway, its claim
is checked the same way).
"""
