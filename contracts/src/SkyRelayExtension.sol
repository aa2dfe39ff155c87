// SPDX-License-Identifier: Apache-2.0
pragma solidity 0.8.26;

import {IAccessControl} from "@openzeppelin/contracts/access/IAccessControl.sol";
import {Math} from "@openzeppelin/contracts/utils/math/Math.sol";
import {SkyRelayStorage} from "./SkyRelayStorage.sol";
import {ISkyRelayExtension} from "./interfaces/ISkyRelayExtension.sol";
import {Member, Proposal, Session, Zone} from "./libraries/Records.sol";

/// @title The extension of SkyRelay: the interface ISkyRelayExtension says what each function does
/// @notice Runs on SkyRelay's storage, by its fallback. Called at its own address it knows nobody and nobody has a
/// role: whatever writes reverts.
contract SkyRelayExtension is SkyRelayStorage, ISkyRelayExtension {
    /// @dev Models in use: what bounds the gas of `determineMDRLModel`.
    uint256 private constant MAX_MODELS = 64;

    // Models

    /// @inheritdoc ISkyRelayExtension
    function registerModel(bytes calldata cid, ModelCard calldata card)
        external
        returns (bytes32 modelId)
    {
        _requireRole(PUBLISHER_ROLE);
        if (cid.length != 36 || cid[0] != 0x01 || cid[2] != 0x12 || cid[3] != 0x20) revert InvalidCID(cid);
        Rules memory rules = _rules;
        if (
            (rules.observationSide != 0 && card.observationSide != rules.observationSide)
                || card.channels != rules.channels || card.actions != rules.actions
        ) revert ModelDoesNotFit(card.observationSide, card.channels, card.actions);
        if (
            card.minUAVs == 0 || card.minUAVs > card.maxUAVs || card.minVehicles > card.maxVehicles
                || card.observationSide % 2 == 0
        ) revert InvalidCard();
        modelId = keccak256(abi.encode(cid, card));
        if (_models[modelId].owner != address(0)) revert ModelAlreadyRegistered(modelId);
        if (_modelList.length == MAX_MODELS) revert TooManyModels(MAX_MODELS);
        _modelList.push(modelId);
        _models[modelId] =
            Model({card: card, owner: msg.sender, codec: cid[1], retired: false, digest: bytes32(cid[4:])});
        emit ModelRegistered(modelId, msg.sender, cid, card);
    }

    /// @inheritdoc ISkyRelayExtension
    function retireModel(bytes32 modelId) external {
        Model storage model = _model(modelId);
        if (model.retired) revert UnknownModel(modelId);
        if (msg.sender != model.owner) _requireRole(0x00);
        model.retired = true;
        // Later models move up one place each, so that the list keeps the order of registration.
        uint256 last = _modelList.length - 1;
        bool found = false;
        for (uint256 i = 0; i < last; ++i) {
            found = found || _modelList[i] == modelId;
            if (found) _modelList[i] = _modelList[i + 1];
        }
        _modelList.pop();
        emit ModelRetired(modelId);
    }

    // Reputation

    /// @inheritdoc ISkyRelayExtension
    function setReputations(address[] calldata members, uint16[] calldata reputations)
        external
    {
        _requireRole(REPUTATION_ROLE);
        if (members.length != reputations.length) revert LengthMismatch(members.length, reputations.length);
        for (uint256 i = 0; i < members.length; ++i) {
            address member = members[i];
            uint16 reputation = reputations[i];
            _requireAtMost(reputation, HUNDRED);
            Member m = _members[member];
            if (m.kind() == 0) revert UnknownMember(member);
            _members[member] = m.withReputation(reputation);
            emit ReputationSet(member, reputation);
        }
    }

    /// @inheritdoc ISkyRelayExtension
    function rateUAV(address uav, bool good) external {
        Member v = _vehicle(msg.sender);
        Member u = _uav(uav);
        uint256 session = _requireMatch(u, v.proposedIndex(), msg.sender, uav);
        if (v.proposedUAV() != u.index() || v.proposedSession() != session) revert NotMatched(msg.sender, uav);
        _members[msg.sender] = v.withProposal(0, 0, 0); // the match is used up
        _rate(uav, u, good);
    }

    /// @inheritdoc ISkyRelayExtension
    function rateVehicle(address vehicle, uint16 index, bool good) external {
        Member u = _uav(msg.sender);
        Member v = _vehicle(vehicle);
        uint256 session = _requireMatch(u, index, vehicle, msg.sender);
        Proposal[MAX_PROPOSALS] storage proposals = _listsOf(u.index(), session).proposals;
        if (proposals[index].vehicle() != vehicle) revert NotMatched(vehicle, msg.sender);
        proposals[index] = Proposal.wrap(0); // the match is used up
        _rate(vehicle, v, good);
    }

    // Views

    /// @inheritdoc ISkyRelayExtension
    function getVehicleInfo(address vehicle) external view returns (VehicleInfo memory) {
        Member v = _vehicle(vehicle);
        return VehicleInfo({
            x: int32(v.x()),
            y: int32(v.y()),
            payment: uint32(v.payment()),
            reputation: uint16(v.reputation()),
            zone: uint32(v.vehicleZone()),
            timestamp: uint40(v.timestamp())
        });
    }

    /// @inheritdoc ISkyRelayExtension
    function getSelectedUAVs(uint32 zone) external view returns (address[] memory uavs) {
        Zone z = _zone(zone);
        uint24[MAX_ZONE_UAVS] storage list = _zoneUAVs[zone];
        uavs = new address[](z.selectedUAVs());
        uint256 found = 0;
        for (uint256 i = 0; found < uavs.length; ++i) {
            Session s = _sessions[list[i]];
            if (s.key() == z.key(zone) && s.selected() != 0) uavs[found++] = _uavList[list[i]];
        }
    }

    /// @inheritdoc ISkyRelayExtension
    function getZoneInfo(uint32 zone) external view returns (ZoneInfo memory) {
        Zone z = _zone(zone);
        return ZoneInfo({
            period: uint32(z.period()),
            round: uint32(z.round()),
            allocating: z.allocating(),
            uavs: uint32(z.uavs()),
            selectedUAVs: uint32(z.selectedUAVs()),
            selectedVehicles: uint32(z.selectedVehicles()),
            modelId: z.hasModel() ? _zoneModels[zone] : bytes32(0)
        });
    }

    /// @inheritdoc ISkyRelayExtension
    function getProposals(address uav) external view returns (VehicleSelection[] memory proposals) {
        Member u = _uav(uav);
        (Session s, bool current) = _session(u);
        proposals = new VehicleSelection[](current ? s.count() : 0);
        Lists storage lists = _listsOf(u.index(), s.number());
        for (uint256 i = 0; i < proposals.length; ++i) {
            Proposal p = lists.proposals[i];
            proposals[i] = VehicleSelection({
                vehicle: p.vehicle(),
                demand: uint32(p.demand()),
                score: uint64(p.score()),
                status: p.vehicle() == address(0) ? ProposalStatus.None : _decision(lists, s.decided(), i)
            });
        }
    }

    /// @inheritdoc ISkyRelayExtension
    function getVehicleSelection(address vehicle)
        external
        view
        returns (ProposalStatus status, address uav, uint16 index)
    {
        Member v = _vehicle(vehicle);
        (status,) = _status(v, _zones[v.vehicleZone()]);
        if (status != ProposalStatus.None) (uav, index) = (_uavList[v.proposedUAV()], uint16(v.proposedIndex()));
    }

    /// @inheritdoc ISkyRelayExtension
    function uavCount() external view returns (uint256) {
        return _uavList.length;
    }

    /// @inheritdoc ISkyRelayExtension
    function uavAt(uint256 index) external view returns (address) {
        return _uavList[index];
    }

    /// @inheritdoc ISkyRelayExtension
    function modelCount() external view returns (uint256) {
        return _modelList.length;
    }

    /// @inheritdoc ISkyRelayExtension
    function modelAt(uint256 index) external view returns (bytes32) {
        return _modelList[index];
    }

    /// @inheritdoc ISkyRelayExtension
    function getModel(bytes32 modelId)
        external
        view
        returns (bytes memory cid, ModelCard memory card, address owner, bool retired)
    {
        Model storage model = _model(modelId);
        cid = abi.encodePacked(bytes1(0x01), model.codec, bytes2(0x1220), model.digest);
        return (cid, model.card, model.owner, model.retired);
    }

    // Ratings

    /// @dev Revert unless proposal `i` of the UAV's last finished session was selected; the session's number.
    function _requireMatch(Member u, uint256 i, address vehicle, address uav) private view returns (uint256 session) {
        if (_rules.ratingStep == 0) revert RatingsOff();
        (Session s, bool current) = _session(u);
        bool finished = !current && s.count() != 0;
        session = finished ? s.number() : s.number() - 1;
        uint256 decided = finished ? s.decided() : s.decidedBefore();
        if (i >= decided || !_isSelected(_listsOf(u.index(), session), i)) revert NotMatched(vehicle, uav);
    }

    function _rate(address member, Member m, bool good) private {
        uint256 reputation = m.reputation();
        if (good) reputation = Math.min(reputation + _rules.ratingStep, HUNDRED);
        else reputation = Math.saturatingSub(reputation, _rules.ratingStep);
        _members[member] = m.withReputation(reputation);
        emit MemberRated(member, msg.sender, good, uint16(reputation));
    }

    /// @dev The roles are SkyRelay's own: at the extension's own address there is nobody to ask, and this reverts.
    function _requireRole(bytes32 role) private view {
        if (!IAccessControl(address(this)).hasRole(role, msg.sender)) {
            revert IAccessControl.AccessControlUnauthorizedAccount(msg.sender, role);
        }
    }

    function _model(bytes32 modelId) private view returns (Model storage model) {
        model = _models[modelId];
        if (model.owner == address(0)) revert UnknownModel(modelId);
    }
}
