"""`python -m dgc_pose` is the command `dgc-pose`."""

from dgc_pose.cli.main import main

if __name__ == "__main__":
    main(prog_name="python -m dgc_pose")
