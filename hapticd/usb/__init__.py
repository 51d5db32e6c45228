"""How a board is spoken to: frames and their codec, the USB link, agreement with the device file.

Bytes in, values out:

    frames     what hapticd_wire.h declares: sizes, structs, bits, OutFrame, InFrame, HelloFrame,
               PROTOCOL_HASH
    codec      encode_*, decode_*, with the CRC; out_packer and in_parser for the servo's buffers;
               ends of a count (I16_LOWEST ...), places in a head (HEAD_SEQ ...)
    session    greet, lost_between, unwrap: who the board is, how many frames were lost, numbers
               that wrap

These three do no I/O, read no clock and need the standard library alone. The rest moves bytes:

    base       Link: what the servo needs of any connection to a board
    link       UsbLink: the board at a USB bus; a simulated board is a backend below it
    flight     InFlight: one OUT and one IN that go on while the servo computes
    usbfs      transfers in flight through Linux itself
    transport  how fast a bus is, measured
    device     Device: link, session and buffers in one, made for one exchange per tick
    events     PinEvents: events at the board's pins, each counted once
    agreement  a board's hello beside its device file
    search     a board that is absent or not ready
"""
