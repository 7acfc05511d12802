"""An slcan adapter on a serial port, with one device behind it on the bus."""

from rigtool.rigs.serial.emulators.server import Emulator
from rigtool.rigs.serial.transport.can_frames import decode, encode

OKAY, NACK = b"\r", b"\a"


class SlcanEmulator(Emulator):
    """Acknowledges commands as a CANable does; frames count only while the channel is open."""

    def __init__(self):
        self.buffer, self.out = b"", b""
        self.open = False
        self.bit_rate = ""

    def receive(self, data):
        self.buffer += data
        *lines, self.buffer = self.buffer.split(b"\r")
        for line in lines:
            answer = self.command(line)
            self.out += answer
        return self.taken()

    def command(self, line):
        if line in (b"O", b"C"):
            self.open = line == b"O"
        elif line[:1] in b"SYs":
            self.bit_rate += line.decode()
        elif self.open:
            try:
                frame = decode(line)
            except ValueError:
                return NACK
            self.on_frame(frame)
            return b"z\r"
        else:
            return NACK
        return OKAY

    def taken(self):
        """Return what is to be sent."""
        out, self.out = self.out, b""
        return out

    def send(self, frame):
        """Put a frame on the bus."""
        if self.open:
            self.out += encode(frame)

    def idle(self):
        self.live()
        return self.taken()

    def on_frame(self, frame):
        """Take a frame from the bus."""
        raise NotImplementedError

    def live(self):
        """Let time pass."""
