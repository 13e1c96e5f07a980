"""Index of this folder: every row of sections 6.1 to 6.5 of the project's physics specification, and its tests.

`ROWS` has one entry a row or rule, in the section's order: section, number, what it is about, tests that prove it. The
last lines are cases of our own. A row without a test, a name that is no test and a test without a row turn this red.
"""

from __future__ import annotations

import ast
from pathlib import Path

ROWS: tuple[tuple[str, int, str, tuple[str, ...]], ...] = (
    ("6.1", 1, "exp(-2 alpha R) underflows", (
        "test_a_wall_at_250_m_in_a_visibility_of_1_m_has_no_transmission_but_a_logarithm",
        "test_a_wall_at_250_m_in_a_visibility_of_1_m_is_no_echo")),
    ("6.1", 2, "range equation solved for R", ("test_the_largest_range_is_solved_from_thin_air_to_a_wall_of_fog",)),
    ("6.1", 3, "fog integral at the near gate", (
        "test_fog_sends_back_its_reference_power",
        "test_fog_before_a_wall_and_under_a_long_ramp_sends_back_its_reference_power",
        "test_an_overlap_that_begins_at_zero_is_refused_by_name",
        "test_a_wall_within_fog_is_measured_without_a_bad_number")),
    ("6.1", 4, "R -> 0", (
        "test_an_echo_that_touches_the_window_takes_half_the_light",
        "test_a_plate_at_the_window_is_not_an_infinite_echo")),
    ("6.1", 5, "sphere and cylinder share", (
        "test_a_sphere_and_a_cylinder_of_a_hundred_millionth_and_of_ten_beams_have_their_shares",)),
    ("6.1", 6, "thin strip", ("test_a_thin_strip_off_the_axis_keeps_eleven_digits",)),
    ("6.1", 7, "disc share", ("test_a_disc_of_a_hundred_millionth_of_the_beam_has_its_share",)),
    ("6.1", 8, "solid angle of a small cone", ("test_the_solid_angle_of_a_cone_of_1_22_mrad_is_exact_to_rounding",)),
    ("6.1", 9, "angle between near-parallel vectors", ("test_directions_a_nanoradian_apart_are_told_apart",)),
    ("6.1", 10, "Q(x) for large x", ("test_the_tail_of_the_normal_law_goes_on_where_it_underflows",)),
    ("6.1", 11, "1 - (1-p)^n", ("test_a_false_alarm_of_less_than_rounding_is_not_zero",)),
    ("6.1", 12, "Kubelka-Munk", ("test_paint_of_almost_nothing_but_absorption_reflects_what_it_should",)),
    ("6.1", 13, "GGX near normal", ("test_a_mirror_lobe_of_a_thousandth_at_normal_incidence_has_its_peak",)),
    ("6.1", 14, "tilted plane spread", ("test_the_range_spread_over_a_plane_met_square_on_is_not_lost",)),
    ("6.1", 15, "leading edge at amplitude = threshold", (
        "test_the_leading_edge_at_the_threshold_is_finite_and_below_it_there_is_no_echo",
        "test_an_amplitude_a_hair_below_the_threshold_is_no_echo_and_at_it_one")),
    ("6.1", 16, "very high SNR", (
        "test_walk_at_a_hundred_million_times_the_threshold_is_a_seventh_of_a_millimetre",
        "test_an_echo_far_over_the_full_scale_is_marked_and_stays_in_its_place")),
    ("6.1", 17, "sum of sub-echoes", ("test_sub_echoes_in_any_order_give_the_same_range_to_a_nanometre",)),
    ("6.2", 1, "table of offsets 0 to 5e6 m; rule 1: recentred in float64; rule 2: refined", (
        "test_an_uneven_wall_far_from_the_origin_is_met_as_at_the_origin",
        "test_vertices_rounded_to_float32_at_5e6_m_are_as_wrong_as_the_table_says")),
    ("6.2", 2, "rule 2: a suspicious distance is kept and counted", (
        "test_an_implausible_plane_leaves_the_casters_distance_and_is_counted",)),
    ("6.2", 3, "rule 3: range error < LSB/8 with offsets up to 1e7 m", (
        "test_a_sensor_and_its_wall_far_from_the_origin_measure_as_at_the_origin",)),
    ("6.2", 4, "robust: leaks at shared edges", (
        "test_of_rays_aimed_at_shared_edges_fewer_than_one_in_ten_thousand_slips_through",
        "test_beams_aimed_at_the_edges_of_a_box_do_not_see_the_wall_behind")),
    ("6.2", 5, "grazing", ("test_grazing_beams_meet_a_road_half_a_metre_below_to_the_last_digit",)),
    ("6.2", 6, "zero-area and NaN triangles", (
        "test_a_vertex_that_is_no_number_is_refused_with_its_triangle",
        "test_a_vertex_farther_than_float64_can_tell_is_refused_with_its_triangle",
        "test_triangles_of_no_area_are_left_out_told_and_do_no_harm",
        "test_a_mesh_of_nothing_but_triangles_of_no_area_is_refused")),
    ("6.2", 7, "slivers", ("test_slivers_at_100_m_are_met_by_the_share_of_beams_that_they_fill",)),
    ("6.2", 8, "coplanar equal triangles", (
        "test_coplanar_twins_are_seen_once_and_told_where_their_materials_differ",
        "test_bodies_that_lie_on_each_other_are_told_where_their_materials_differ",
        "test_actors_that_rest_have_twins_and_those_that_move_have_none",
        "test_of_many_bodies_on_each_other_a_few_are_told_and_the_rest_counted",
        "test_bodies_smaller_than_what_tells_twins_apart_are_none",
        "test_twins_are_not_looked_for_among_too_many_triangles")),
    ("6.2", 9, "dists overwritten, second rays behind the surface", (
        "test_a_cast_leaves_its_arguments_as_they_were",
        "test_a_ray_behind_glass_starts_behind_it_and_misses_nothing_close_behind")),
    ("6.2", 10, "threads and batches", (
        "test_threads_share_a_caster_and_its_scenes",
        "test_rays_are_the_same_alone_and_in_batches_of_any_size")),
    ("6.2", 11, "table of 98 to 1e7 triangles", (
        "test_many_triangles_are_built_in_proportion_and_met_where_they_are",)),
    ("6.3", 1, "divergence 0", (
        "test_a_beam_without_divergence_is_its_axis",
        "test_a_beam_without_divergence_sees_a_wire_of_any_width_or_not",
        "test_a_beam_of_nearly_no_divergence_in_rain_and_snow_is_its_axis")),
    ("6.3", 2, "divergence 10 deg, limit 20", (
        "test_half_a_plane_under_a_beam_of_10_and_20_degrees_has_its_share",
        "test_a_divergence_over_20_degrees_is_refused_by_name")),
    ("6.3", 3, "pulse 0.1 ns", (
        "test_a_pulse_of_a_tenth_of_a_nanosecond_needs_less_than_a_megabyte_a_beam",
        "test_mixed_echoes_of_a_short_pulse_part_where_a_long_one_joins_them")),
    ("6.3", 4, "pulse 1 us", (
        "test_a_pulse_of_a_microsecond_and_of_a_hundred_is_one_echo",
        "test_the_blind_zone_after_a_clipped_echo_does_not_end_with_a_long_pulse")),
    ("6.3", 5, "R < r1", (
        "test_nothing_is_seen_before_beam_and_field_of_view_meet",
        "test_nothing_is_reported_from_before_a_near_gate",
        "test_a_gate_before_the_overlap_sees_nothing_of_a_layer")),
    ("6.3", 6, "SNR 1e6", ("test_an_echo_a_million_times_over_the_noise_saturates",)),
    ("6.3", 7, "V = 1 m, 1e6 m, rain 300 mm/h and 0", (
        "test_fog_from_1_m_to_1000_km_is_finite_and_thins_out",
        "test_rain_from_none_to_300_mm_h_is_finite_and_thickens",
        "test_weather_at_its_ends_gives_numbers_on_every_sensor",
        "test_weather_that_is_none_is_refused_by_name",
        "test_a_laser_beside_its_filter_sees_no_drop")),
    ("6.3", 8, "wavelength with a law outside its range", (
        "test_a_law_outside_its_wavelengths_gives_its_value_and_a_warning",
        "test_a_visibility_outside_a_law_is_not_clamped",
        "test_a_material_without_a_value_at_a_wavelength_is_refused_by_name")),
    ("6.3", 9, "zero-area target, empty scene", (
        "test_an_empty_scene_is_a_scan_without_echoes",
        "test_an_actor_without_a_shape_and_a_plane_seen_edge_on_are_not_seen",
        "test_a_target_of_no_area_is_refused_by_name",
        "test_an_empty_scene_is_sent_as_no_echo_in_every_beam")),
    ("6.3", 10, "sensor inside an object", (
        "test_a_sensor_inside_an_object_sees_its_inner_faces",
        "test_a_sensor_on_a_surface_and_in_a_corner_gives_numbers")),
    ("6.3", 11, "object at 100 m/s", (
        "test_a_plate_that_recedes_at_100_m_s_has_each_beams_own_range_on_the_wire",)),
    ("6.3", 12, "1e7 triangles", ("test_many_triangles_are_built_in_proportion_and_met_where_they_are",)),
    ("6.3", 13, "3 identical echoes", (
        "test_three_equal_sub_echoes_at_one_range_are_one_of_three_times_the_energy",
        "test_three_strips_side_by_side_return_what_one_plate_does")),
    ("6.3", 14, "the same scan twice", ("test_a_scan_measured_twice_is_the_same_to_the_last_bit",)),
    ("6.4", 1, "error of pose steps", ("test_the_error_of_one_pose_a_scan_is_what_the_section_says",)),
    ("6.4", 2, "receding plate: R0 + v t_j", (
        "test_a_plate_that_recedes_at_100_m_s_has_each_beams_own_range_on_the_wire",
        "test_a_plate_that_recedes_has_each_beams_own_range_over_a_whole_revolution_of_100_ms",
        "test_beams_in_any_order_of_their_instants_see_what_each_would_alone",
        "test_sensor_and_target_that_move_together_see_each_other_at_rest")),
    ("6.4", 3, "a static scene, machinery on and off", (
        "test_what_rests_is_the_same_with_the_machinery_of_motion_on_and_off",)),
    ("6.4", 4, "motion during the flight time", (
        "test_motion_during_the_lights_way_is_left_out_and_is_less_than_half_a_step",)),
    ("6.5", 1, "round half up to the LSB", (
        "test_an_lms_rounds_half_up_to_its_unit",
        "test_an_ld_rounds_half_up_to_a_256th_of_a_metre",
        "test_a_measured_wall_is_rounded_from_its_own_float64_range")),
    ("6.5", 2, "beyond the format: no echo, never wrapped", (
        "test_an_lms_range_beyond_the_format_is_the_word_for_no_echo_and_never_wraps",
        "test_an_ld_range_beyond_the_format_is_the_word_for_no_echo_and_never_wraps",
        "test_a_dazzled_beam_has_its_own_word_whatever_its_range")),
    ("6.5", 3, "from the unrounded range, once", (
        "test_a_word_is_worked_out_from_the_unrounded_range_only_once",)),
    ("own", 1, "what the model cannot do is refused by name", (
        "test_what_the_model_cannot_do_is_refused_by_name",
        "test_materials_of_no_and_of_all_reflectance_give_numbers")),
    ("own", 2, "scenarios at random", (
        "test_whatever_is_allowed_keeps_the_contract_and_comes_twice_the_same",
        "test_a_plate_at_any_range_and_tilt_keeps_the_contract",
        "test_any_value_of_a_choice_is_taken_or_refused_by_name",
        "test_a_plan_of_any_length_is_a_scan_of_that_length",
        "test_a_medium_that_clips_beyond_its_window_is_measured",
        "test_more_single_drops_than_can_be_drawn_are_a_continuum_or_refused")),
    ("own", 3, "the foot of a medium's own echo, and echoes at their threshold in it", (
        "test_fog_alone_is_crossed_where_the_closed_form_says",
        "test_ranges_in_fog_are_those_of_bins_many_times_finer",
        "test_the_foot_is_that_of_30_m_of_visibility",
        "test_an_echo_at_its_threshold_in_60_m_of_fog_is_the_same_in_full",
        "test_a_valley_at_the_level_decides_on_no_more_than_the_spread_of_the_planes_ranges",
        "test_ranges_behind_a_valley_in_fog_change_by_little_as_the_level_passes_it")),
)  # fmt: skip
COUNTS = {"6.1": 17, "6.2": 11, "6.3": 14, "6.4": 4, "6.5": 3, "own": 3}
"Rows of the tables of 6.1 and 6.3; of 6.2, 6.4 and 6.5 the tables, rules and sentences that can fail."


def names_of_tests_here() -> set[str]:
    """Names of all tests in this folder's files."""
    names: set[str] = set()
    for path in Path(__file__).parent.glob("test_*.py"):
        if path.name != Path(__file__).name:
            tree = ast.parse(path.read_text(encoding="utf-8"))
            found = [node.name for node in tree.body if isinstance(node, ast.FunctionDef)]
            names |= {name for name in found if name.startswith("test_")}
    return names


def test_every_row_has_its_number_and_its_tests() -> None:
    for section, count in COUNTS.items():
        assert [number for where, number, _, _ in ROWS if where == section] == list(range(1, count + 1))
    assert all(tests for _, _, _, tests in ROWS)
    assert {where for where, *_ in ROWS} == set(COUNTS)


def test_the_index_and_the_tests_of_this_folder_name_each_other() -> None:
    indexed = {name for _, _, _, tests in ROWS for name in tests}
    assert indexed == names_of_tests_here()
