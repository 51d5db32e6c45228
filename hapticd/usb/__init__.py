"""Communication with a board: frames and their codec, the USB link, agreement with the device file.

Bytes in, values out:

    frames     the declarations of hapticd_wire.h: sizes, structs, bits, OutFrame, InFrame,
               HelloFrame, PROTOCOL_HASH
    codec      encode_*, decode_*, with the CRC; out_packer and in_parser for the servo's buffers;
               ends of a count (I16_LOWEST ...), places in a head (HEAD_SEQ ...); greet,
               lost_between, unwrap: handshake, lost frames, numbers that wrap

These three do no I/O, read no clock and need the standard library alone. The rest moves bytes:

    codec      Link: the servo's interface to any connection to a board
    link       UsbLink: the board at a USB bus; a simulated board is a backend below it
    flight     InFlight: one OUT and one IN in progress while the servo computes; transfers in
               flight through Linux itself
    search     search for a board that is absent or not ready; measurement of the bus; comparison of
               a board's hello with its device file
    device     Device: link, session and buffers in one, for one exchange per tick; PinEvents:
               events at the board's pins, each counted once
"""
