"""Dynamixel servos on a pseudo-terminal: protocol 2.0 with byte stuffing, CRC, ping and sync read."""

import os
import pty
import select
import threading
import tty

HEADER = b"\xff\xff\xfd\x00"
PING = 0x01
SYNC_READ = 0x82
STATUS = 0x55
BROADCAST = 0xFE


def _crc_table():
    table = []
    for byte in range(256):
        crc = byte << 8
        for _ in range(8):
            crc = (crc << 1) ^ 0x8005 if crc & 0x8000 else crc << 1
        table.append(crc & 0xFFFF)
    return table


_CRC = _crc_table()


def crc_of(data):
    """Return the checksum of a packet."""
    crc = 0
    for byte in data:
        crc = ((crc << 8) ^ _CRC[(crc >> 8 ^ byte) & 0xFF]) & 0xFFFF
    return crc


def stuffed(body):
    """Return instruction and parameters with a further FD after each FF FF FD."""
    return body.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")


def packet(servo, body):
    """Return a whole packet."""
    body = stuffed(body)
    head = HEADER + bytes([servo]) + (len(body) + 2).to_bytes(2, "little") + body
    return head + crc_of(head).to_bytes(2, "little")


class EmulatedBus:
    """Servos whose positions [ticks] a test sets.

    Attributes:
        positions: {id: ticks}.
        drop: Answers of these ids get lost.
        damage: Answers of these ids have a wrong checksum.
        lose_every: Loses each n-th answer; 0: none.
        deaf_n: So many readings of all servos to come are not answered.
    """

    def __init__(self, positions):
        self.positions = dict(positions)
        self.drop = set()
        self.damage = set()
        self.lose_every = 0
        self.deaf_n = 0
        self.answers_n = 0
        self.wrong_crc_n = 0
        self._master, self._slave = pty.openpty()
        tty.setraw(self._master)
        tty.setraw(self._slave)
        self.port = os.ttyname(self._slave)
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self):
        pending = b""
        while not self._ends.is_set():
            readable, _, _ = select.select([self._master], [], [], 0.05)
            if not readable:
                continue
            try:
                pending += os.read(self._master, 4096)
            except OSError:
                return
            pending = self._take(pending)

    def _take(self, data):
        while True:
            start = data.find(HEADER)
            if start < 0 or len(data) < start + 7:
                return data[max(start, 0) :]
            data = data[start:]
            length = int.from_bytes(data[5:7], "little")
            whole, rest = data[: 7 + length], data[7 + length :]
            if len(whole) < 7 + length:
                return data
            if crc_of(whole[:-2]) == int.from_bytes(whole[-2:], "little"):
                self._obey(
                    whole[4], whole[7], whole[8:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
                )
            else:
                self.wrong_crc_n += 1
            data = rest

    def _obey(self, servo, instruction, parameters):
        if instruction == PING:
            for each in sorted(self.positions):
                if servo in (BROADCAST, each):
                    self._answer(each, b"\x06\x04\x26")
        elif instruction == SYNC_READ and self.deaf_n > 0:
            self.deaf_n -= 1
        elif instruction == SYNC_READ:
            for each in parameters[4:]:
                if each in self.positions:
                    ticks = self.positions[each] & 0xFFFFFFFF
                    self._answer(each, ticks.to_bytes(4, "little"))

    def _answer(self, servo, data):
        self.answers_n += 1
        if servo in self.drop or (self.lose_every and self.answers_n % self.lose_every == 0):
            return
        answer = bytearray(packet(servo, bytes([STATUS, 0]) + data))
        if servo in self.damage:
            answer[-1] ^= 0x5A
        os.write(self._master, bytes(answer))

    def unplug(self):
        """Pull the cable."""
        self._ends.set()
        self._thread.join(2.0)
        os.close(self._master)
        os.close(self._slave)
        self._master = self._slave = -1

    def close(self):
        """Take the bus away."""
        if self._master >= 0:
            self.unplug()
