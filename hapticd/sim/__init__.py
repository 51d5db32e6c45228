"""The simulated board, behind the same pyusb interface as a real one.

board      BoardModel: the firmware, bytes in and bytes out on integer nanoseconds; `hello` and
           `control_replies`, its self-description
axis       one axis of it: outputs, plant, fail-safe, perturbation FIFO and 4 kHz probe
backend    make_backend: the board as a pyusb backend, with the errors of libusb 1.0, behind a bus
           whose transfers may take time
events     EventPins: the event pins of the firmware
injection  with_injections: seeded faults between the two
bus        duration of transfers: a fixed time, or a model of full speed behind xHCI; Flight:
           asynchronous transfers of the board; the errors of libusb as pyusb raises them
usb_device, usbip  UsbDevice and UsbipServer: the same board on the real USB bus of any Linux
"""
