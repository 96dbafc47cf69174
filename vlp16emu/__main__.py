"""`python -m vlp16emu` is `vlp16emu`."""

from vlp16emu.cli import main

if __name__ == "__main__":
    main()
