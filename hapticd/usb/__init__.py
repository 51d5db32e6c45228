"""The way to a board: an abstract link, the USB link, and the device behind either.

base.Link       what the servo needs of any way to a board
usb.UsbLink     the board at a USB bus; a simulated board is a backend below it
flight.InFlight one OUT and one IN that go on while the servo computes; usbfs: through Linux itself
device.Device   link, protocol session and buffers in one, made for one exchange per tick
"""
