"""`python -m vlp16emu` is `vlp16emu`."""

import signal


def main() -> None:
    """Run the program; while it is loading, Ctrl-C ends it without a message."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from vlp16emu.cli import main as run

    run()


if __name__ == "__main__":
    main()
