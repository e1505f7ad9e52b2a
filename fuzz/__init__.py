"""A fuzzer: damaged and hostile input, class by class, must end in a value or in an InputError.

``make fuzz`` tries 10,000 mutants in processes of their own, with bounds on time and memory;
``python -m fuzz --help`` shows the rest. Each finding becomes a test in ``tests/``.
"""
