"""Recordings: HDF5 files that survive, one 1-D dataset per channel, readable without this package.

A recorder is an ordinary client of the daemon. It writes every tick, every sample of the probe and
every event while they come, and what was flushed outlives the recorder. A finished recording says
where it comes from, can be replayed bit by bit, and is exported to MATLAB and CSV.

    servo.raw, probe, event, flight --recorder--> NAME.part.h5
                                (live: SWMR, uncompressed, flushed every 100 ms)
                                | pack, when the recording ends
                                v
                                NAME.h5  (HDF5 1.8 format, compressed, with checksums)

    /servo/<field>   one value per tick; raw frames are bytes (n, 64) and (n, 32)
    /energy/<cause>_j   the energy ledger, one sum per tick
    /probe/<field>   4 kHz, counts; attributes per_count, sign, offset_count, unit explain them
    /event, /gap, /life   what happened; where records are missing; where another servo life begins
    /replay          checkpoints and obeyed requests: with /servo all that `hapticd replay` needs
    attributes       schema, provenance, configuration, what real-time rights were granted, UTC of
                     the monotonic clock, note

Rules. Numbers are int64, float64, float32, small unsigned integers or fixed-length text: what
Octave 7 and MATLAB load. All datasets and attributes exist before the live file becomes SWMR.
Nothing is compressed while live: compression with frequent flushes writes forty times the bytes.
After kill -9 all that was flushed is there, but such a file opens only as SWMR reader, so `rec
recover` packs it. What would break it: two writers of one file, a dataset made late, a reader that
trusts equal lengths of a crashed file's columns (`file` cuts them).

For scripts:

    recorder    RecordingParams, record: record a running daemon
    file        open_recording: a `Recording`, whatever kind of file it is in
    replay      replay_recording: replay a recording, with settings held at other values
    pack        pack, summary: the final file; to_mat, to_csv: its exports
    provenance  provenance: the versions that numbers come from

`live` (rows of the live file), `superblock` (the first bytes of a file whose writer died), `energy`
(the energy ledger) and `stretch` (the part of a recording that is one trial) are for the other
modules, as are `calibrations` and `certificate`, on which a device's numbers rest.
"""
