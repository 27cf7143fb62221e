"""Counts. Arguments come as `name=value`, in SI units. The printed output is in `dca logs` and in the record.

A stop is a SIGTERM: what has to be let go of is let go of in `finally`.
"""

import signal
import sys
import time


def main() -> int:
    arguments = dict(word.split("=", 1) for word in sys.argv[1:])
    until, every = int(float(arguments["until"])), float(arguments["every"])
    try:
        for number in range(1, until + 1):
            print(number, flush=True)
            time.sleep(every)
        return 0
    finally:
        print("letting go", flush=True)


if __name__ == "__main__":
    # An exception runs `finally`. The default, a plain end, would not run it.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    sys.exit(main())
