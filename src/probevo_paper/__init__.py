"""The experiments of the papers, repeated in simulation or on the recordings that they used.

==================  ===========================================  =============  ================
paper               table or figure                              modules        command
==================  ===========================================  =============  ================
PROBE               Fig. 4 and 5: errors of features under blur  figure_5*      paper blur
PROBE               Table I: drives of KITTI                     table_i*       paper table-i
PROBE-GK            Table I (thesis Table 1.2): four kinds of    table_1_2*     paper table-1.2
                    place
PROBE-GK            Table II and Fig. 8 (thesis Table 1.3 and    table_1_3*     paper table-1.3
                    Fig. 1.20): loops, EM without truth
thesis chapter 5    a simulated sun sensor bounds the heading    sun*           paper sun
thesis chapter 6    DPC-Net: corrections of a wrong calibration  dpc_net*       paper dpc-net
thesis chapter 7    HydraNet: 1-D regression, orbiting camera    hydranet*      paper hydranet
==================  ===========================================  =============  ================

Each command follows the word ``probevo``, e.g. ``probevo paper blur --out out/blur``.

Of each experiment, ``NAME_config.py`` holds the settings, ``NAME.py`` what is measured and what was
published, ``NAME_files.py`` or ``NAME_page.py`` the results as files, and ``command_NAME.py`` the
experiment from the first recording to the last file: read that one first. ``gk_tables.py`` is what
both tables of PROBE-GK have in common, ``table_files.py`` and ``command_steps.py`` what all tables
have. ``command.py`` reads the command line.

Three words mean one thing each here. An *estimator* is a noise model with the settings that the
odometry runs with: a column of a table. A *trial* is a recording to test on and the drive that the
learned estimators are trained on for it: a row of a table. A *kernel* is the generalized kernel of
PROBE-GK.

Nothing is imported here, so that ``probevo paper --help`` stays fast.
"""
