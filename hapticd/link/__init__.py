"""The way to a board: an abstract link, the USB link, and the device that gives its counts a meaning."""
