"""Options, threads, processes, and libraries behind one module each."""
