"""Run the command line of surctl as `python -m surctl`."""

from surctl.cli import main

if __name__ == "__main__":
    main()
