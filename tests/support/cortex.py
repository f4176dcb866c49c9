"""Exported C code on an emulated Cortex-M4; tests of it are skipped where compiler or emulator is missing."""

import shutil
import subprocess
from pathlib import Path

import pytest

needs_cortex = pytest.mark.skipif(
    shutil.which("arm-none-eabi-gcc") is None or shutil.which("qemu-system-arm") is None,
    reason="there is no compiler for a Cortex-M4, or no qemu-system-arm",
)
_CORE = ["-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"]
# The board mps2-an386: code at 0, RAM at 0x20000000. The reset handler switches the floating-point unit on.
_LINKER = """
ENTRY(reset)
MEMORY { FLASH (rx) : ORIGIN = 0x00000000, LENGTH = 4M  RAM (rwx) : ORIGIN = 0x20000000, LENGTH = 4M }
SECTIONS {
  .text : { KEEP(*(.vectors)) *(.text*) *(.rodata*) *(.ARM.exidx*) *(.init*) *(.fini*) } > FLASH
  .data : { *(.data*) } > RAM
  .bss : { __bss_start__ = .; *(.bss*) *(COMMON) __bss_end__ = .; end = .; } > RAM
  __stack = 0x20300000;
}
"""
_START = """
#include <stdlib.h>
extern int main(void);
extern void initialise_monitor_handles(void);
void reset(void);
void _init(void) {}
void _fini(void) {}
__attribute__((section(".vectors"), used)) static void *const vectors[] = {(void *)0x20300000, (void *)reset};
void reset(void)
{
  *(volatile unsigned *)0xE000ED88 |= 0xFu << 20;
  __asm volatile("dsb\\n isb");
  initialise_monitor_handles();
  exit(main());
}
"""


def run_on_cortex(folder: Path, prefix: str, place: Path, *, single: bool) -> str:
    """Return what the test program of exported code prints on the board."""
    (place / "board.ld").write_text(_LINKER)
    (place / "start.c").write_text(_START)
    flags = [f"-D{prefix.upper()}_FLOAT"] if single else []
    sources = [place / "start.c", folder / f"{prefix}.c", folder / f"{prefix}_test.c"]
    words = ["arm-none-eabi-gcc", *_CORE, "-std=gnu99", "-O2", *flags, "-I", str(folder), *map(str, sources)]
    words += ["--specs=rdimon.specs", "-nostartfiles", "-T", str(place / "board.ld"), "-lm", "-o", str(place / "t.elf")]
    subprocess.run(words, check=True, capture_output=True)
    words = ["qemu-system-arm", "-M", "mps2-an386", "-nographic", "-semihosting", "-kernel", str(place / "t.elf")]
    return subprocess.run(words, check=True, capture_output=True, text=True, timeout=60, stdin=subprocess.DEVNULL).stdout
