"""Fits a machine to measurements: rows, registrations, least squares, outliers, noise."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ppmcal.lazy import on_first_use

if TYPE_CHECKING:
    from ppmcal.calibration.fit.campaign import HALF as HALF
    from ppmcal.calibration.fit.campaign import MissingPoses as MissingPoses
    from ppmcal.calibration.fit.campaign import WeakCampaign as WeakCampaign
    from ppmcal.calibration.fit.campaign import geometry as geometry
    from ppmcal.calibration.fit.campaign import grouped as grouped
    from ppmcal.calibration.fit.campaign import poses_in_use as poses_in_use
    from ppmcal.calibration.fit.campaign import room as room
    from ppmcal.calibration.fit.campaign import too_few as too_few
    from ppmcal.calibration.fit.campaign import weak_shapes as weak_shapes
    from ppmcal.calibration.fit.coverage import LEAST as LEAST
    from ppmcal.calibration.fit.coverage import Z95 as Z95
    from ppmcal.calibration.fit.coverage import coverage_by as coverage_by
    from ppmcal.calibration.fit.coverage import coverage_of as coverage_of
    from ppmcal.calibration.fit.coverage import half_interval as half_interval
    from ppmcal.calibration.fit.coverage import half_of_mixture as half_of_mixture
    from ppmcal.calibration.fit.coverage import half_or as half_or
    from ppmcal.calibration.fit.coverage import variances as variances
    from ppmcal.calibration.fit.fit_result import OUTLIER as OUTLIER
    from ppmcal.calibration.fit.fit_result import Fit as Fit
    from ppmcal.calibration.fit.fit_result import FitOptions as FitOptions
    from ppmcal.calibration.fit.fit_result import data_rows as data_rows
    from ppmcal.calibration.fit.fit_result import directions as directions
    from ppmcal.calibration.fit.fit_result import posterior as posterior
    from ppmcal.calibration.fit.fit_result import prediction_covariance as prediction_covariance
    from ppmcal.calibration.fit.fit_result import prediction_root as prediction_root
    from ppmcal.calibration.fit.fit_result import residual_freedom as residual_freedom
    from ppmcal.calibration.fit.fit_result import unfitted as unfitted
    from ppmcal.calibration.fit.fit_result import values_taken as values_taken
    from ppmcal.calibration.fit.fitting import identify as identify
    from ppmcal.calibration.fit.flatness import Flat as Flat
    from ppmcal.calibration.fit.flatness import flats as flats
    from ppmcal.calibration.fit.gauge import by_defining as by_defining
    from ppmcal.calibration.fit.gauge import mirror_images as mirror_images
    from ppmcal.calibration.fit.gauge import seen_from_frames as seen_from_frames
    from ppmcal.calibration.fit.gauge import with_gauge as with_gauge
    from ppmcal.calibration.fit.gauss_newton import CONVERGED as CONVERGED
    from ppmcal.calibration.fit.gauss_newton import least_squares as least_squares
    from ppmcal.calibration.fit.homing_shift import HomingShift as HomingShift
    from ppmcal.calibration.fit.linearisation import NormalStep as NormalStep
    from ppmcal.calibration.fit.linearisation import column_scale as column_scale
    from ppmcal.calibration.fit.linearisation import natural_units as natural_units
    from ppmcal.calibration.fit.linearisation import prior_weights as prior_weights
    from ppmcal.calibration.fit.linearisation import qr_factor as qr_factor
    from ppmcal.calibration.fit.linearisation import seen_directions as seen_directions
    from ppmcal.calibration.fit.linearisation import to_prior as to_prior
    from ppmcal.calibration.fit.noise_estimate import FAILED_NOISE as FAILED_NOISE
    from ppmcal.calibration.fit.noise_estimate import LARGER as LARGER
    from ppmcal.calibration.fit.noise_estimate import OVERSTATED as OVERSTATED
    from ppmcal.calibration.fit.noise_estimate import SMALLER as SMALLER
    from ppmcal.calibration.fit.noise_estimate import STATED as STATED
    from ppmcal.calibration.fit.noise_estimate import Noise as Noise
    from ppmcal.calibration.fit.noise_estimate import against_tolerances as against_tolerances
    from ppmcal.calibration.fit.noise_estimate import known_part as known_part
    from ppmcal.calibration.fit.noise_estimate import noise_check as noise_check
    from ppmcal.calibration.fit.noise_estimate import noise_parts as noise_parts
    from ppmcal.calibration.fit.noise_estimate import noise_sentences as noise_sentences
    from ppmcal.calibration.fit.noise_estimate import noise_source as noise_source
    from ppmcal.calibration.fit.noise_estimate import noise_state as noise_state
    from ppmcal.calibration.fit.noise_estimate import with_estimated_noise as with_estimated_noise
    from ppmcal.calibration.fit.noise_estimate import with_noise as with_noise
    from ppmcal.calibration.fit.noise_estimate import with_own_noise as with_own_noise
    from ppmcal.calibration.fit.normal_equations import WhiteBlock as WhiteBlock
    from ppmcal.calibration.fit.normal_equations import white_blocks as white_blocks
    from ppmcal.calibration.fit.nuisance_columns import NuisanceColumns as NuisanceColumns
    from ppmcal.calibration.fit.observation import GAP as GAP
    from ppmcal.calibration.fit.observation import coordinates as coordinates
    from ppmcal.calibration.fit.observation import gap_names as gap_names
    from ppmcal.calibration.fit.observation import gap_noise as gap_noise
    from ppmcal.calibration.fit.observation import labels as labels
    from ppmcal.calibration.fit.observation import noise as noise
    from ppmcal.calibration.fit.observation import noise_quantity as noise_quantity
    from ppmcal.calibration.fit.observation import shown as shown
    from ppmcal.calibration.fit.observation import stretched as stretched
    from ppmcal.calibration.fit.observation import turn_between as turn_between
    from ppmcal.calibration.fit.observation import typical_noise as typical_noise
    from ppmcal.calibration.fit.observation import values_per_row as values_per_row
    from ppmcal.calibration.fit.observation import wrapped as wrapped
    from ppmcal.calibration.fit.other_assemblies import assembled_at as assembled_at
    from ppmcal.calibration.fit.other_assemblies import assemblies as assemblies
    from ppmcal.calibration.fit.other_assemblies import middle_row as middle_row
    from ppmcal.calibration.fit.other_branch import branch_findings as branch_findings
    from ppmcal.calibration.fit.other_branch import in_other_branch as in_other_branch
    from ppmcal.calibration.fit.outliers import GrossError as GrossError
    from ppmcal.calibration.fit.outliers import GrossErrors as GrossErrors
    from ppmcal.calibration.fit.outliers import UncheckedRows as UncheckedRows
    from ppmcal.calibration.fit.outliers import contradictions as contradictions
    from ppmcal.calibration.fit.outliers import find_gross_errors as find_gross_errors
    from ppmcal.calibration.fit.outliers import gross_errors as gross_errors
    from ppmcal.calibration.fit.outliers import gross_mask as gross_mask
    from ppmcal.calibration.fit.outliers import rows_with_outliers as rows_with_outliers
    from ppmcal.calibration.fit.outliers import single_gross_rows as single_gross_rows
    from ppmcal.calibration.fit.prior_information import BENT as BENT
    from ppmcal.calibration.fit.prior_information import SEEN as SEEN
    from ppmcal.calibration.fit.prior_information import DefiningParameters as DefiningParameters
    from ppmcal.calibration.fit.prior_information import PoseResiduals as PoseResiduals
    from ppmcal.calibration.fit.prior_information import Posterior as Posterior
    from ppmcal.calibration.fit.prior_information import PriorInformation as PriorInformation
    from ppmcal.calibration.fit.prior_information import SessionKnowledge as SessionKnowledge
    from ppmcal.calibration.fit.prior_information import of_data as of_data
    from ppmcal.calibration.fit.problem import Problem as Problem
    from ppmcal.calibration.fit.problem import State as State
    from ppmcal.calibration.fit.problem import squares_by_noise_of as squares_by_noise_of
    from ppmcal.calibration.fit.problem import white_squares as white_squares
    from ppmcal.calibration.fit.rank import RANK_TOLERANCE as RANK_TOLERANCE
    from ppmcal.calibration.fit.rank import Rank as Rank
    from ppmcal.calibration.fit.rank import Unidentifiable as Unidentifiable
    from ppmcal.calibration.fit.rank import analyse as analyse
    from ppmcal.calibration.fit.rank import observability as observability
    from ppmcal.calibration.fit.rank import pivoted as pivoted
    from ppmcal.calibration.fit.rank import unidentifiable as unidentifiable
    from ppmcal.calibration.fit.rank import whole_rank as whole_rank
    from ppmcal.calibration.fit.registration_freedoms import WORTH as WORTH
    from ppmcal.calibration.fit.registration_freedoms import RegistrationHint as RegistrationHint
    from ppmcal.calibration.fit.registration_freedoms import hint_sentences as hint_sentences
    from ppmcal.calibration.fit.registration_freedoms import hint_words as hint_words
    from ppmcal.calibration.fit.registration_freedoms import is_open as is_open
    from ppmcal.calibration.fit.registration_freedoms import odds_of_opening as odds_of_opening
    from ppmcal.calibration.fit.registration_freedoms import opened as opened
    from ppmcal.calibration.fit.registration_freedoms import (
        registration_hints as registration_hints,
    )
    from ppmcal.calibration.fit.registration_freedoms import (
        significant_improvement as significant_improvement,
    )
    from ppmcal.calibration.fit.registration_freedoms import surely as surely
    from ppmcal.calibration.fit.repeated_rows import ENOUGH_REPEATS as ENOUGH_REPEATS
    from ppmcal.calibration.fit.repeated_rows import repeats_scatter as repeats_scatter
    from ppmcal.calibration.fit.response import Response as Response
    from ppmcal.calibration.fit.row_distances import Distances as Distances
    from ppmcal.calibration.fit.row_distances import distances as distances
    from ppmcal.calibration.fit.row_distances import explained_distances as explained_distances
    from ppmcal.calibration.fit.row_distances import huber_weights as huber_weights
    from ppmcal.calibration.fit.row_distances import toleranced as toleranced
    from ppmcal.calibration.fit.secondary_analyses import FAILURES as FAILURES
    from ppmcal.calibration.fit.secondary_analyses import LEFT_OUT as LEFT_OUT
    from ppmcal.calibration.fit.secondary_analyses import left_out_note as left_out_note
    from ppmcal.calibration.fit.secondary_analyses import pictures_beside as pictures_beside
    from ppmcal.calibration.fit.secondary_analyses import secondary as secondary
    from ppmcal.calibration.fit.unknown_directions import (
        with_unknown_directions as with_unknown_directions,
    )
    from ppmcal.calibration.fit.white_rows import Companion as Companion
    from ppmcal.calibration.fit.white_rows import Rows as Rows
    from ppmcal.calibration.fit.white_rows import whitened as whitened
    from ppmcal.calibration.fit.work import bounded as bounded

if not TYPE_CHECKING:   # type checkers read the names above
    __getattr__ = on_first_use(__name__)
