"""Errors of pyusb on libusb 1.0 on Linux: their numbers, codes and texts."""

import errno

from usb.core import USBError, USBTimeoutError

LIBUSB_ERRORS = {  # errno: (libusb code, libusb_strerror)
    errno.EIO: (-1, "Input/Output Error"),
    errno.EINVAL: (-2, "Invalid parameter"),
    errno.EACCES: (-3, "Access denied (insufficient permissions)"),
    errno.ENODEV: (-4, "No such device (it may have been disconnected)"),
    errno.ENOENT: (-5, "Entity not found"),
    errno.EBUSY: (-6, "Resource busy"),
    errno.ETIMEDOUT: (-7, "Operation timed out"),
    errno.EOVERFLOW: (-8, "Overflow"),
    errno.EPIPE: (-9, "Pipe error"),
    errno.EINTR: (-10, "System call interrupted (perhaps due to signal)"),
    errno.ENOMEM: (-11, "Insufficient memory"),
    errno.ENOSYS: (-12, "Operation not supported or unimplemented on this platform"),
}


def usb_error(number: int) -> Exception:
    """Return the exception of pyusb's libusb1 backend for `number`; ENOSYS is not a
    USBError there.
    """
    code, text = LIBUSB_ERRORS[number]
    if number == errno.ENOSYS:
        return NotImplementedError(text)
    error: Exception = (USBTimeoutError if number == errno.ETIMEDOUT else USBError)(
        text, code, number
    )
    return error
