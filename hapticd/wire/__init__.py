"""Bytes in, values out: the USB protocol between host and board. No I/O, no clock, standard
library only.

    frames   what hapticd_wire.h declares: sizes, structs, bits, OutFrame, InFrame, HelloFrame,
             PROTOCOL_HASH
    codec    encode_*, decode_*, with the CRC; out_packer and in_parser for the servo's buffers;
             ends of a count (I16_LOWEST ...), places in a head (HEAD_SEQ ...)
    session  greet, SequenceCounter, unwrap: who the board is, which frame comes next, numbers
             that wrap
"""
