"""Recordings: HDF5 files, one 1-D dataset per channel, readable without this package.

A recorder is an ordinary client of the daemon. It writes every tick, every sample of the probe and
every event as they arrive, and the written data outlive the recorder. A finished recording contains
its origin, can be replayed bit by bit, and is exported to MATLAB and CSV.

    servo.raw, probe, event, flight --recorder--> NAME.part.h5
                                (live: append-only, a frame of raw records every 100 ms)
                                | pack, when the recording ends
                                v
                                NAME.h5  (HDF5 1.8 format, compressed, with checksums)

    /servo/<field>   one value per tick; raw frames are bytes (n, 64) and (n, 32)
    /energy/<cause>_j   the energy ledger, one sum per tick
    /probe/<field>   4 kHz, counts; attributes per_count, sign, offset_count, unit explain them
    /event, /gap, /life   events; positions of missing records; starts of servo lives
    /replay          checkpoints and obeyed requests: with /servo all that `hapticd replay` needs
    attributes       schema, provenance, configuration, granted real-time rights, UTC of the
                     monotonic clock, note

Rules. Numbers are int64, float64, float32, small unsigned integers or fixed-length text, which
Octave 7 and MATLAB load. The live file is not HDF5: `file` reads it while it grows. After kill -9
it holds all complete frames, and `rec recover` packs them. A file must have one writer.

For scripts:

    recorder    RecordingParams, record: record a running daemon
    file        open_recording: a `Recording` from any kind of file; replay_recording: replay a
                recording, with some settings replaced
    pack        pack, summary: the final file; to_mat, to_csv: its exports
    replay      replay, difference: the servo's step over a segment of records, bit by bit
    provenance  provenance: the versions behind the numbers

`live` (the live file and its rows) is for the other modules, as are the energy ledger in `file`,
the part of a recording that is one trial in `pack`, and the calibrations and the certificate in
`provenance`, the basis of a device's numbers.
"""
