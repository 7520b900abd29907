"""Which tests go first, which are enough for a first look, and which only run at night."""

# By the beginning of their names: those that compile most, then those that take longest. Whoever
# comes later finds the code compiled, and short tests at the end leave no processor waiting.
FIRST = (
    # Each of these three compiles what others need, which wait for it if they begin beside it.
    "tests/flow/test_env.py::TestEpisodes",
    "tests/test_vector_env.py::TestBesideSingles",
    "tests/test_axes.py",
    "tests/flow/test_env.py",
    "tests/test_env.py",
    "tests/agents/rules/",
    "tests/test_own.py",
    "tests/agents/test_programs.py",
    "tests/parallel/",
    "tests/agents/learning/",
    "tests/agents/evaluation/",
    "tests/docs/test_site.py",
    "tests/cuda/test_kernels.py",
    "tests/web/test_tasks.py",
    "tests/test_play.py",
    "tests/web/test_home.py",
    "tests/agents/runtime/test_simulator.py",
    "tests/learners/",
    "tests/agents/test_tuning.py",
    "tests/agents/planning/",
    # Pages need the modules of those above, which are then there.
    "tests/web/test_playground.py",
    "tests/web/test_agents.py",
    "tests/paper/",
    "tests/test_docs.py",
    "tests/test_wheel.py",
)

# Folders whose tests share a fixture that takes long: one process runs them.
TOGETHER = ("tests/paper/",)

# Of each part those that fail first when it breaks, and one environment of each class.
SMOKE = (
    "tests/agents/learning/test_config.py",
    "tests/agents/test_policy.py",
    "tests/agents/rules/test_layouts.py::test_they_sort",
    "tests/design/test_fixed_layout.py::test_it_finds_the_least",
    "tests/physics/test_friction.py",
    "tests/physics/test_signed_distance.py",
    "tests/physics/test_step.py",
    "tests/flow/test_env.py::TestEpisodes::test_action_spaces",
    "tests/flow/test_exits.py",
    "tests/flow/test_stream.py",
    "tests/tasks/test_sort.py::TestEnds::test_by_choice",
    "tests/test_parcel.py",
    "tests/test_config.py::test_",
    "tests/test_simulation.py",
    "tests/test_surface.py",
    "tests/test_vector_env.py::TestBesideSingles::test_also_over_whole_episodes",
)

# Of each kind of flow.
OF_FLOWS = (
    "TestCheckers::test_gymnasiums_has_nothing_to_say",
    "TestEpisodes::test_types_spaces_and_sums",
    "TestTwins::test_go_on_alike",
    "TestBesideSingles::test_each_environment_is_a_single_env",
)
# Of streams, whose modules take half a minute to compile: by day the home page's line is equal to
# Python's to the bit.
OF_STREAMS = (
    "tests/web/test_tasks.py::test_a_stream_is_equal_in_which_parcels_touch_or_leave",
    "tests/web/test_playground.py::"
    "test_a_task_begins_by_seed_runs_and_gives_the_same_run_in_python",
)
# Of agents on slopes.
OF_SLOPES = tuple(
    f"tests/web/test_agents.py::{test}"
    for test in (
        "test_a_rule_on_a_slope_runs_as_in_python_again_too",
        "test_a_policy_of_parcels_chooses_as_in_python",
        "test_a_policy_of_modules_chooses_as_in_python",
        "test_an_agent_is_loaded_as_it_is_chosen_and_its_script_gives_the_same_run",
    )
)
# A policy that learns on each slope, and its results: Merge is tried each time.
LEARNING_ON_SLOPES = (
    "tests/agents/learning/test_slopes.py::test_a_policy_is_left_that_acts_in_its_task"
)
# Infos of each task in two processes of Gymnasium's; of Sort and Merge each time.
OF_INFOS = (
    "tests/learners/test_learners.py::test_a_library_stacks_infos_in_its_own_way"
    "[gymnasium-by_gymnasium-SmartSurface/"
)
SAMPLE_OF_AN_ENTRY = "tests/agents/benchmark/test_results.py::test_a_sample_comes_out_the_same"
# Pages whose code compiles kernels that no other test needs.
PAGES_AT_NIGHT = ("sensors.md", "material-flow.md")
# Long proofs of which the rest of the tests hold a short form: `pytest -m nightly`.
NIGHTLY = (
    "tests/cuda/test_kernels.py::TestPtx::test_streams_compile",
    "tests/cuda/test_kernels.py::TestPtx::test_every_task_compiles",
    "tests/agents/export/test_kernels.py::test_states_are_equal_to_the_bit_on_the_baseline",
    # A kernel of streams takes twenty seconds to compile; others hold each part of these.
    *(
        f"tests/flow/test_env.py::{test}[{actions}, presence"
        for test in OF_FLOWS
        for actions in ("modules", "parcels")
    ),
    "tests/agents/planning/test_receding_horizon.py::test_what_is_planned_happens[lab",
    "tests/flow/test_module_parallel_env.py::TestTasks::test_pettingzoos_checks_pass[sequence",
    *(
        "tests/flow/test_module_parallel_env.py::TestTasks::"
        f"test_the_same_run_as_the_single_env_and_its_rewards[{reward}-sequence"
        for reward in ("parcel", "team")
    ),
    *(
        "tests/agents/export/test_web.py::"
        f"test_modules_obey_the_same_where_all_is_of_another_run_but_what_is_copied[{task}"
        for task in ("singulate", "sequence")
    ),
    *(
        f"tests/agents/rules/test_steering.py::test_it_serves_every_task[{task}"
        for task in ("slow", "orient", "track")
    ),
    "tests/agents/evaluation/test_drives.py::test_a_stream_is_carried_by_driven_modules",
    # With libraries that only the night has.
    "tests/agents/benchmark/test_plots.py::test_each_task_with_entries_has_two_figures",
    "tests/agents/benchmark/test_plots.py::test_rliable_finds_the_board_s_scores_and_intervals",
    "tests/agents/benchmark/test_plots.py::test_its_interquartile_mean_is_rliable_s",
    "tests/test_course.py::TestRuns",
    "tests/benchmarks/test_actuators.py",
    "tests/test_actuators.py::TestWaiting::test_under_streams_too",
    # Kernels of their own: other cases of the same test hold the rest by day.
    "tests/agents/rules/test_patterns.py::test_each_pattern_moves_a_parcel_as_predicted[31",
    "tests/agents/rules/test_slopes.py::TestPatterns::"
    "test_more_parcels_leave_one_by_one[singulate-arguments3",
    "tests/flow/test_parallel_env.py::TestContract::"
    "test_pettingzoos_checks_pass[{'orientations': 'any', 'sensors': Presence",
    "tests/test_axes.py::TestAnyAngle::"
    "test_the_angles_of_choices_move_it_as_the_choices_do[SmartSurface/Park-v0-window",
    "tests/learners/test_learners.py::"
    "test_a_library_stacks_infos_in_its_own_way[minari-by_minari-SmartSurface/Sequence",
    *(
        f"tests/test_modules.py::test_gymnasiums_checker_has_nothing_to_say[{task}"
        for task in (
            *("slow", "stop", "track", "orient", "park"),
            *("flow", "singulate", "merge", "sequence"),
        )
    ),
    *(
        f"tests/machine/test_identification.py::{test}"
        for test in (
            "test_a_surface_is_found_within_the_intervals",
            "test_runs_that_coast_do_not_tell",
            "test_an_uneven_surface_is_not_explained",
            *(
                f"test_delays_of_pictures_and_of_axes_only_have_one_effect[free{k}"
                for k in (0, 1, 3, 4, 5)
            ),
        )
    ),
    "tests/agents/runtime/test_recording.py::test_a_log_",
    "tests/web/test_camera.py::test_a_stream_is_sensed_as_in_python",
    *(
        f"tests/agents/benchmark/test_results.py::test_a_sample_comes_out_the_same[{task}"
        for task in ("slow", "stop", "track", "orient", "sort-ppo-lab")
    ),
    "tests/docs/test_site.py::TestSite",
    "tests/parallel/test_jobs.py::test_a_command_that_was_killed_goes_on_with_a_custom_task",
    "tests/parallel/test_jobs.py::test_a_design_s_answer_is_the_same",
    "tests/parallel/test_jobs.py::test_a_job_whose_node_dies_is_done_again_and_only_that",
    "tests/parallel/test_jobs.py::test_a_search_has_trials_of_the_nodes",
    "tests/parallel/test_jobs.py::test_results_are_the_same_those_of_a_runs_policies_too",
    "tests/parallel/test_jobs.py::test_seeds_with_nodes_dying_come_to_the_same_files_as_in_"
    "processes",
    # The first and the last trial that may be interrupted.
    *(
        "tests/agents/test_tuning.py::TestResuming::"
        f"test_interrupted_trials_run_once_more_and_finished_ones_do_not[{at}"
        for at in (0, 13)
    ),
    "tests/web/test_agents.py::test_a_rule_on_a_slope_leaves_a_wider_gap_where_a_camera_errs",
    "tests/web/test_own_task.py::test_its_script_gives_the_same_end_in_another_process[{'camera'",
    "tests/web/test_agents.py::test_a_rule_runs_as_in_python[camera",
    OF_STREAMS[0],
    *(
        f"{OF_STREAMS[1]}[{task}"
        for task in (
            *("slow", "stop", "track", "orient", "park"),
            *("flow", "singulate", "merge", "sequence"),
        )
    ),
    "tests/web/test_camera.py::test_an_episode_is_sensed_as_in_python",
    *OF_SLOPES,
    *(f"{LEARNING_ON_SLOPES}[{case}" for case in ("singulate", "sequence", "merge-parcels")),
    # The slowest rule of several whose layouts are found by search.
    *(
        f"tests/agents/rules/test_rules.py::{test}[orient: best fixed layout"
        for test in (
            "test_an_environment_alone_is_as_among_many",
            "test_mirrored_starts_end_in_mirror_images",
        )
    ),
    # All that varies of a task, where Sort is tried each time.
    *(
        f"{test}[SmartSurface/{task}-v0"
        for test in (
            "tests/test_vector_env.py::TestBesideSingles::test_also_where_everything_varies",
            "tests/test_vector_env.py::TestBatchSize::"
            "test_neither_it_nor_the_number_of_threads_matters",
            "tests/test_env.py::TestTwins::test_go_on_alike",
        )
        for task in ("Slow", "Stop", "Track", "Orient", "Park")
    ),
    # Drawings of the other goals that are lines.
    *(
        f"tests/core/test_pictures.py::{test}[SmartSurface/{task}-v0"
        for test in (
            "test_the_goal_is_where_the_options_say",
            "TestSame::test_only_the_observation_differs_from_that_of_features",
            "test_the_checkers_have_nothing_to_say",
        )
        for task in ("Slow", "Orient")
    ),
    # Kernels of their own, where others are tried of the same kind of action or sensor.
    *(
        "tests/test_axes.py::TestAnyAngle::test_the_angles_of_choices_move_it_as_the_choices_do"
        f"[SmartSurface/{case}"
        for case in (
            "Track-v0-modules",
            "Slow-v0-window",
            "Stop-v0-halves",
            "Orient-v0-modules",
            "Park-v0-modules",
            "Sort-v0-quadrants",
        )
    ),
    "tests/test_axes.py::TestAnyAngle::test_the_angles_of_choices_move_it_as_the_choices_do[turning",
    *(
        f"tests/test_axes.py::TestSeenAxes::test_the_rest_is_as_without[{k}"
        for k in ("modules", "window")
    ),
    "tests/agents/rules/test_braking.py::"
    "test_braking_holds_where_it_is_not_as_in_the_study[slow axes, stop",
    "tests/agents/rules/test_rules.py::test_what_sets_all_modules_alike_does_so_with_any_kind"
    "[track-make2-quadrants",
    "tests/agents/planning/test_models.py::"
    "test_whatever_the_sensors_say_it_moves_as_the_environment_does[track",
    *(
        f"tests/core/test_batch.py::test_each_module_turns_to_the_angle_its_part_says[{actions}"
        for actions in ("halves", "window")
    ),
    *(
        "tests/test_config.py::TestObserve::"
        f"test_the_parcel_and_the_rotors_under_its_base_are_shown[{task}"
        for task in ("slow", "track")
    ),
    "tests/agents/rules/test_slopes.py::TestTimeSlots::test_it_holds_off_what_it_was_tuned_on"
    "[arguments4",
    *(
        "tests/agents/planning/test_models.py::"
        f"test_in_a_lab_it_is_the_start_of_the_environment_with_all_its_noise[{task}"
        for task in ("sort", "stop", "track", "orient", "park")
    ),
    "tests/web/test_agents.py::test_a_policy_of_the_lab_sees_axes_and_outline_and_acts_as_in_python",
    *(
        f"{OF_INFOS}{task}"
        for task in (*("Slow", "Stop", "Track", "Orient", "Park"), "Flow", "Singulate", "Sequence")
    ),
    # By day one task of a parcel is equal to Python's to the bit.
    *(
        f"tests/web/test_tasks.py::test_episodes_are_equal_from_their_starts_to_their_ends[{task}"
        for task in ("slow", "track", "orient", "park", "stop")
    ),
    "tests/web/test_agents.py::test_a_run_on_a_slope_acts_as_in_python",
    "tests/web/test_agents.py::test_without_agents_a_task_on_a_slope_has_the_player_and_layouts",
    "tests/web/test_own_task.py::test_its_script_gives_the_same_end_in_another_process[{'stuck'",
    *(
        f"tests/web/test_agents.py::test_a_rule_runs_as_in_python[exact-{task}"
        for task in ("slow", "track", "orient", "park")
    ),
    # By day the playground's driven modules are equal to Python's.
    "tests/web/test_tasks.py::test_driven_modules_are_equal_too",
    # By day two parcels that meet are held against MuJoCo.
    "tests/validation/test_drawn.py::test_parcels_that_push_each_other_end_as_in_mujoco[Crowd",
    # Streams with any angle; single parcels have them by day.
    "tests/flow/test_claims.py::TestCommands::test_modules_follow_the_half_of_their_owner[any",
    "tests/agents/test_tuning.py::test_it_leaves_a_configuration_that_learns",
    # An algorithm's run is resumed: PPO's, DQN's and those on streams without sensors by day.
    *(
        "tests/agents/learning/test_runs.py::test_an_interrupted_run_is_resumed_to_the_same_result"
        f"[{algorithm}"
        for algorithm in ("local", "schedule", "modules")
    ),
    "tests/agents/learning/test_runs.py::test_a_damaged_checkpoint_and_a_foreign_one_are_refused"
    "[local",
    "tests/agents/learning/test_training.py::test_modules_learn_for_the_lab_from_more_features",
    "tests/agents/rules/test_slopes.py::TestTimeSlots::test_parcels_leave_one_by_one[merge",
    "tests/agents/rules/test_layouts.py::test_it_leads_along_a_path_that_rolling_strays_from",
    "tests/agents/rules/test_layouts.py::"
    "test_at_any_angle_a_fixed_layout_sorts_as_slowly_as_rules_do",
    "tests/agents/test_programs.py::test_the_comparison_of_a_task",
    "tests/agents/benchmark/test_results.py::test_the_board_of_the_documentation_shows_them",
    # By day each entry of one parcel is tried on its first task, whose kernel others compile.
    *(
        f"{SAMPLE_OF_AN_ENTRY}[{task}"
        for task in ("park", "flow", "singulate", "merge", "sequence")
    ),
    *(
        f"{SAMPLE_OF_AN_ENTRY}[{task}-{name}"
        for task in ("slow", "stop", "track", "orient")
        for name in ("best rule", "fixed layout", "ppo-1m")
    ),
    "tests/agents/benchmark/test_board.py::test_an_interval_covers_the_truth_as_often_as_it_says",
    "tests/agents/benchmark/test_process.py::TestGood::test_a_zip_file_acts_as_here[DQN",
    "tests/benchmarks/test_tracking.py::test_no_parcel_is_swapped_and_as_many_are_delivered_as_of_known_parcels",
    "tests/benchmarks/test_transports.py::test_wrong_messages_do_no_harm_and_a_machine_is_back",
    "tests/agents/runtime/test_simulator.py::"
    "test_a_simulator_that_was_killed_is_there_again_at_the_same_address",
    "tests/test_own.py::test_the_cache_holds_and_notices_an_edit_of_a_users_file",
    "tests/agents/test_tuning.py::TestResuming::test_a_killed_search_of_several_workers_is_resumed",
    "tests/agents/test_tuning.py::TestTrials::"
    "test_values_lie_in_the_space_and_tpe_finds_better_ones",
    *(f"tests/test_docs.py::test_the_code_of_a_page_runs[docs/{page}" for page in PAGES_AT_NIGHT),
    "tests/test_wheel.py::test_environment_and_shipped_agent_work",
    "tests/learners/test_learners.py::test_it_learns_to_sort[cleanrl",
    "tests/test_hub.py::test_environments_are_those_of_the_package",  # whose kernel is its own
    "tests/learners/test_learners.py::test_pixels_are_learned_from",
    *(
        f"tests/test_axes.py::TestOnRequest::test_nothing_is_there_unasked[SmartSurface/{task}-v0"
        for task in ("Slow", "Stop", "Track", "Orient", "Park")
    ),
)


def place_of(name: str) -> int:
    """Place of a test in the order, by its name; those not in FIRST share the last."""
    found = (k for k, beginning in enumerate(FIRST) if name.startswith(beginning))
    return next(found, len(FIRST))
