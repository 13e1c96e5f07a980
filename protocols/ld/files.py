"""Files that a host keeps in the device's flash: services 0701 to 0704 (UPS p. 41-42)."""

from __future__ import annotations

from collections.abc import Mapping

FLASH_WORDS = 32_768
HEADER_WORDS = 2
"Of each file; the listing gives no number, two make its free words come out even. [I]"
FIRST_ID = 0x0100

SAVED, NO_MEMORY, EXISTS, FLASH_FAILED, BAD_SAVE = range(5)
LOADED, ABSENT, BAD_LOAD = range(3)
DELETED, NOT_THERE, DELETE_FAILED, BAD_DELETE = range(4)

Words = tuple[int, ...]
Files = Mapping[int, Words]
"ID -> its words. Replaced as a whole; kept over power-off."


def free_words(files: Files) -> int:
    """Words that are not used."""
    return FLASH_WORDS - sum(HEADER_WORDS + len(words) for words in files.values())


def saved(files: Files, words: Words) -> tuple[Files, int]:
    """The files after SAVE of an ID and its words, and the status; a file that is there has to be deleted first."""
    if len(words) < 2 or words[0] < FIRST_ID:
        return files, BAD_SAVE
    if words[0] in files:
        return files, EXISTS
    if HEADER_WORDS + len(words) - 1 > free_words(files):
        return files, NO_MEMORY
    return {**files, words[0]: words[1:]}, SAVED


def deleted(files: Files, words: Words) -> tuple[Files, int]:
    """The files after DELETE of an ID, and the status."""
    if not words or words[0] < FIRST_ID:
        return files, BAD_DELETE
    if words[0] not in files:
        return files, NOT_THERE
    return {number: data for number, data in files.items() if number != words[0]}, DELETED
