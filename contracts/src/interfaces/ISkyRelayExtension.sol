// SPDX-License-Identifier: Apache-2.0
pragma solidity 0.8.26;

import {ISkyRelayTypes} from "./ISkyRelayTypes.sol";

/// @title What SkyRelay does beyond the paper's table of functions: the model registry, reputations, more views
/// @notice Called at the address of SkyRelay, which passes on what it does not know itself.
interface ISkyRelayExtension is ISkyRelayTypes {
    /// @notice Publish a model. Its id is the hash of its CID and card.
    /// @param cid binary CIDv1 with a sha2-256 multihash (36 bytes).
    function registerModel(bytes calldata cid, ModelCard calldata card) external returns (bytes32 modelId);

    /// @notice Take a model out of use, by its owner or an admin. Zones that it was assigned to keep it.
    function retireModel(bytes32 modelId) external;

    /// @notice Set reputations by the consortium's authority.
    function setReputations(address[] calldata members, uint16[] calldata reputations) external;

    /// @notice Rate the UAV that selected the calling vehicle in its last finished session, once.
    function rateUAV(address uav, bool good) external;

    /// @notice Rate a vehicle that the calling UAV selected in its last finished session, once.
    /// @param index of the vehicle's proposal in that session.
    function rateVehicle(address vehicle, uint16 index, bool good) external;

    /// @notice A vehicle's record.
    function getVehicleInfo(address vehicle) external view returns (VehicleInfo memory);

    /// @notice UAVs of a zone that selected at least one vehicle in the current period.
    function getSelectedUAVs(uint32 zone) external view returns (address[] memory);

    /// @notice A zone at this moment.
    function getZoneInfo(uint32 zone) external view returns (ZoneInfo memory);

    /// @notice The current period's proposals to a UAV, by index.
    function getProposals(address uav) external view returns (VehicleSelection[] memory);

    /// @notice The vehicle's latest proposal in the current period.
    function getVehicleSelection(address vehicle)
        external
        view
        returns (ProposalStatus status, address uav, uint16 index);

    /// @notice How many UAVs are registered.
    function uavCount() external view returns (uint256);

    /// @notice The UAV at a place in the list of all; those of zone 0 are the pool.
    function uavAt(uint256 index) external view returns (address);

    /// @notice How many models are in use.
    function modelCount() external view returns (uint256);

    /// @notice The id of the model at a place in the list of those in use, the first registered first.
    function modelAt(uint256 index) external view returns (bytes32);

    /// @notice A model, also one that is retired; `cid` is the binary CIDv1.
    function getModel(bytes32 modelId)
        external
        view
        returns (bytes memory cid, ModelCard memory card, address owner, bool retired);
}
