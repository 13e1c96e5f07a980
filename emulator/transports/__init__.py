"""The links of a sensor: pty, serial, tcp, udp, loop, socketcand, slcan, python-can; `schemes` opens them.

Belongs here: payloads with the instant of their first byte, paced, never blocking. A link's module is loaded when
such a link is asked for. Not: whose bytes they are (instrument).

May import: `emulator.errors`, `protocols`, `process` (private folders).
"""
