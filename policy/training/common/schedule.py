"""When a run warms up, decays and ends."""

import time


def add_arguments(parser, rate, warmup):
    """The flags that the functions below read."""
    parser.add_argument("--rate", type=float, default=rate)
    parser.add_argument("--warmup", type=int, default=warmup)
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--decay", type=int, default=0, help="steps of the decay before --steps")
    parser.add_argument("--until", help="local time HH:MM by which the rate is to reach zero")
    parser.add_argument("--until-decay", type=float, default=1500, help="seconds of that decay")


def seconds_until(clock):
    """Seconds from now to the next HH:MM, negative for half a day after it has passed."""
    hour, minute = map(int, clock.split(":"))
    now = time.localtime()
    left = (hour - now.tm_hour) * 3600 + (minute - now.tm_min) * 60 - now.tm_sec
    return (left + 43200) % 86400 - 43200


def learning_rate(args, step):
    """Warm-up from the step `args.begun`, plateau, and a linear decay to zero at the end."""
    rate = args.rate * min(1.0, (step - args.begun + 1) / args.warmup)
    if args.decay:
        rate *= max(0.0, min(1.0, (args.steps - step) / args.decay))
    if args.until:
        rate *= max(0.0, min(1.0, seconds_until(args.until) / args.until_decay))
    return rate


def ended(args, step):
    """Whether the run has had its steps, or its time."""
    return step >= args.steps or (args.until is not None and seconds_until(args.until) < 0)
