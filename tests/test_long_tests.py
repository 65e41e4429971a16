"""Long tests run at night; what each of them guards has a small case by day, and here stands which."""

import ast
from pathlib import Path

TESTS = Path(__file__).parent
BY_DAY = {
    "certificates/test_outside_checkers": {
        "certificates_are_confirmed_and_a_thousand_forged_ones_of_each_kind_refused": (
            "a_certificate_is_confirmed_by_two_checkers_and_refused_when_it_is_forged"
        )
    },
    "certificates/test_uncertain_certificate": {
        "a_witness_settles_windows_whose_relations_are_not_proved_to_say_all": (
            "the_witness_is_within_the_users_bounds"
        )
    },
    "cli/test_streaming_command": {
        "killed_at_half_and_resumed_in_little_memory": "interrupted_is_130_and_says_how_to_go_on"
    },
    "consistency/test_gains": {"no_healthy_window_is_a_fault": "verdicts_are_those_of_a_linear_program"},
    "consistency/test_long_windows": {
        "gradients_of_margins_are_those_of_finite_differences": (
            "diagnosis/test_uncertain_margins::margins_change_with_bounds_and_data"
        )
    },
    "consistency/test_searched": {
        "no_lie_makes_a_fault_of_a_million_windows": "a_lying_device_makes_no_verdict"
    },
    "diagnosis/test_uncertain_margins": {
        "margins_of_several_relations_change_with_bounds_and_data": "margins_change_with_bounds_and_data"
    },
    "estimation/test_laid_end_to_end": {
        "a_hundred_thousand_samples_laid_end_to_end": "random_plants_laid_end_to_end"
    },
    "estimation/test_joint_observer": {
        "two_hundred_thousand_fault_free_samples": (
            "the_state_of_fault_free_recordings_is_inside_and_nothing_is_a_fault"
        ),
        "five_thousand_cases_near_the_boundary": (
            "it_proves_what_programs_over_all_samples_refute_and_nothing_else"
        ),
    },
    "estimation/test_multimodel_validation": dict.fromkeys(
        [
            "partial_outputs_of_two_small_models",
            "the_paper_s_scenario_from_the_mixture_alone",
            "the_paper_s_scenario_where_partial_outputs_are_measured",
            "a_plant_that_is_off_needs_uncertain_models",
        ],
        "parts_are_weighed_and_the_verdict_is_the_worst",
    ),
    "estimation/test_observer": {
        "two_million_fault_free_samples": (
            "the_state_of_fault_free_recordings_is_inside_and_nothing_is_a_fault"
        )
    },
    "estimation/test_observer_averages": {
        "many_draws_that_keep_averages_are_never_a_fault": "draws_that_keep_averages_are_never_a_fault"
    },
    "estimation/test_parameters": {
        "the_true_parameters_of_a_thousand_recordings_are_never_lost": "the_true_parameters_are_never_lost"
    },
    "estimation/test_unknown_input_observer": dict.fromkeys(
        ["half_a_million_fault_free_samples", "fifty_thousand_fault_free_samples_of_joint_observers"],
        "the_state_of_fault_free_recordings_is_inside_and_nothing_is_a_fault",
    ),
    "estimation/test_validation_tclab": {
        "enclosures_hold_on_the_unseen_run_and_a_bias_is_located_and_corrected": (
            "estimation/test_validation::the_paper_s_system"
        )
    },
    "estimation/test_validation_soundness": dict.fromkeys(
        [
            "a_million_fault_free_windows_give_no_alarm",
            "gaps_and_two_of_three_sensors_at_once_with_a_disturbance_of_one_direction",
        ],
        "fault_free_recordings_give_no_alarm",
    ),
    "models/test_linearize": {
        "random_plants_obey_their_models_about_any_point": "every_step_inside_the_region_obeys_the_model"
    },
    "relations/test_averages": {
        "random_models_agree_with_linear_programs": (
            "verdicts_and_the_size_of_margins_are_those_of_a_linear_program"
        ),
        "many_random_models_agree_with_linear_programs": (
            "verdicts_and_the_size_of_margins_are_those_of_a_linear_program"
        ),
    },
    "relations/test_uncertain_image": {
        "image_out_of_jit_is_the_exact_zonotope_within_its_error": (
            "image_is_the_exact_zonotope_within_its_error"
        )
    },
    "runs/test_engine": {"twenty_kills": "a_worker_that_dies_costs_its_task_alone"},
    "sets/inclusion/test_inclusion_fuzz": {
        "no_composition_of_many_misses_its_value": "no_random_composition_misses_its_value"
    },
    "sets/intervals/test_elementary": {
        "a_million_points_are_enclosed": "the_value_at_a_point_is_enclosed_within_eight_ulps"
    },
    "sets/linear_systems/test_linear_systems": {
        "all_published_systems_are_reproduced": "published_2x2_systems_are_reproduced",
        "twenty_thousand_random_systems_are_enclosed": "random_systems_are_enclosed",
        "the_hull_of_more_rows_than_unknowns_is_narrower": (
            "more_rows_than_unknowns_hold_at_once_and_a_contradiction_is_a_proof"
        ),
        "eager_boxes_hold_the_solutions": "random_systems_are_enclosed",
    },
    "sets/strips/test_separation": {
        "the_proofs_say_the_same_eagerly": "every_verdict_near_the_boundary_is_proved_and_sharp"
    },
    "sets/strips/test_varying": dict.fromkeys(
        [
            "margins_have_the_sign_of_linear_programs_on_20000_zonotopes",
            "float32_and_uncompiled_code_prove_the_same",
        ],
        "margins_have_the_sign_and_size_of_linear_programs",
    ),
    "sets/zonotopes/test_decisions": {
        "ten_thousand_points_are_decided_as_by_linear_programs": (
            "points_near_and_far_from_the_boundary_are_decided_as_by_linear_programs"
        ),
        "five_thousand_constrained_zonotopes_are_empty_where_linear_programs_say_so": (
            "constrained_zonotopes_are_empty_where_linear_programs_say_so"
        ),
    },
    "sets/zonotopes/test_decisions_many": {
        "ten_thousand_pairs_of_sets_are_decided_as_by_linear_programs": (
            "sets/zonotopes/test_decisions::"
            "two_sets_meet_where_a_linear_program_says_so_and_are_separated_where_not"
        ),
        "ten_thousand_inclusions_are_decided_as_by_linear_programs_and_exact_numbers": (
            "sets/zonotopes/test_decisions::a_zonotope_shrunk_is_held_and_one_that_reaches_out_is_not"
        ),
    },
    "sets/zonotopes/test_shapes_many": {
        "ten_thousand_random_sets_are_as_in_exact_numbers": "some_random_sets_are_as_in_exact_numbers"
    },
    "studies/montecarlo/test_montecarlo_scenario": {
        "rates_grow_with_the_horizon_as_golden": (
            "diagnosis/test_scenario::detection_rate_grows_with_the_horizon_as_golden"
        ),
        "no_false_alarm_in_ten_million_healthy_windows": (
            "studies/test_study_families::a_study_finds_what_is_large_and_alarms_nobody_else"
        ),
        "a_plain_comparison_would_be_wrong_at_the_vertices": (
            "consistency/test_long_windows::verdicts_are_sharp"
        ),
        "every_kind_of_model_and_fault_is_counted_without_a_false_alarm": (
            "studies/test_study_families::a_study_finds_what_is_large_and_alarms_nobody_else"
        ),
        "the_same_rates_through_recordings": (
            "studies/montecarlo/test_montecarlo::counts_are_those_of_detect_on_the_same_recordings"
        ),
        "the_adversary_hides_whatever_a_linear_program_can_hide": (
            "studies/test_study_families::an_adversary_says_which_tests_it_knows"
        ),
    },
    "studies/tuning/test_tuning": {
        "parameters_move_and_detect_has_the_last_word": (
            "smallest_scale_is_that_of_the_linear_programs_and_never_above"
        )
    },
    "test_docs": {
        # `make docs` builds them in CI
        "pages_build_without_a_warning": "sections_taken_from_the_readme_are_there"
    },
    "test_healthy_variants": {
        "no_healthy_recording_of_many_is_faulty_and_none_loses_rows": (
            "no_healthy_recording_is_faulty_and_none_loses_rows"
        )
    },
    "test_fuzz": {
        "many_more_model_files_and_recordings_give_a_page_or_a_sentence": (
            "model_files_with_any_field_of_any_type_give_a_page_or_a_sentence"
        )
    },
    "test_plants": {
        "air_handling_unit": "diagnosis/test_tclab::the_unseen_half_of_the_healthy_run_has_no_fault"
    },
}


def marks(function):
    """Return the marks of a function that leave it out of the default suite."""
    texts = {ast.unparse(decorator) for decorator in function.decorator_list}
    return {mark for mark in ("slow", "long") if f"pytest.mark.{mark}" in texts}


def functions_of(path):
    """Return {name: function} of the tests of a file, without the prefix."""
    tree = ast.walk(ast.parse(path.read_text()))
    functions = (node for node in tree if isinstance(node, ast.FunctionDef))
    return {f.name.removeprefix("test_"): f for f in functions if f.name.startswith("test_")}


FILES = {str(p.relative_to(TESTS).with_suffix("")): functions_of(p) for p in sorted(TESTS.rglob("test_*.py"))}


def test_every_long_test_has_a_small_one_by_day():
    for file, functions in FILES.items():
        long = {name for name, function in functions.items() if "long" in marks(function)}
        stated = BY_DAY.get(file, {})
        assert long <= set(stated), f"say in BY_DAY which test of {file} guards the same by day"
        assert set(stated) <= set(functions)
        for sibling in stated.values():
            place, _, name = sibling.rpartition("::")
            function = FILES[place or file][name]
            assert not marks(function), f"{sibling} is left out of the default suite, too"
