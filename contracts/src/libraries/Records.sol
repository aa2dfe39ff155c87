// SPDX-License-Identifier: Apache-2.0
pragma solidity 0.8.26;

/// Records of one storage slot each, as words: a struct's decoding and encoding took a third of the code.
/// Fields are named with their first bit and their width; the functions below are their only readers and writers.

/// @dev A UAV or a vehicle. Both: x 0:32, y 32:32, timestamp 128:32, kind 160:8, reputation 168:16.
/// UAV: altitude 64:16, battery 80:16, bandwidth 96:32, zone 184:32, place in the zone's list 216:16, index 232:24.
/// Vehicle: payment 64:32, zone 96:32, and its latest proposal: UAV's index 184:24, session 208:32, proposal 240:16.
type Member is uint256;

/// @dev A UAV's proposals and selections in one period of one zone: number 0:32, zone 32:32, period 64:32; count of
/// proposals ever taken 96:16; the first `decided` 112:16 of them have been through an allocation; vehicles selected
/// 128:16; bandwidth committed to them 144:32; `decided` of the session before 176:16.
/// It is over when the zone's period is another, or when the UAV left, ran empty or was reset: then the next session,
/// without proposals, stands here in zone 0.
type Session is uint256;

/// @dev demand 0:32, score 32:64, vehicle 96:160. 0 is withdrawn.
type Proposal is uint256;

/// @dev period 0:32, round 32:32, UAVs 64:16, cursor of an allocation 80:16, UAVs with a selection 96:16, selected
/// vehicles 112:32, allocating 144:1, has a model 145:1. 0 is unknown.
type Zone is uint256;

using MemberLibrary for Member global;
using SessionLibrary for Session global;
using ProposalLibrary for Proposal global;
using ZoneLibrary for Zone global;

library MemberLibrary {
    uint256 internal constant UAV = 1;
    uint256 internal constant VEHICLE = 2;

    function x(Member m) internal pure returns (int256) {
        return int32(uint32(Member.unwrap(m)));
    }

    function y(Member m) internal pure returns (int256) {
        return int32(uint32(Member.unwrap(m) >> 32));
    }

    function timestamp(Member m) internal pure returns (uint256) {
        return uint32(Member.unwrap(m) >> 128);
    }

    function kind(Member m) internal pure returns (uint256) {
        return uint8(Member.unwrap(m) >> 160);
    }

    function reputation(Member m) internal pure returns (uint256) {
        return uint16(Member.unwrap(m) >> 168);
    }

    function withReputation(Member m, uint256 value) internal pure returns (Member) {
        return Member.wrap(Member.unwrap(m) & ~(uint256(0xffff) << 168) | value << 168);
    }

    /// @dev The fields below bit 160, which the member itself rewrites.
    function withInfo(Member m, uint256 info) internal pure returns (Member) {
        return Member.wrap(Member.unwrap(m) >> 160 << 160 | info);
    }

    // UAV

    function uavInfo(int32 x_, int32 y_, uint256 altitude_, uint256 battery_, uint256 bandwidth_)
        internal
        view
        returns (uint256)
    {
        return uint32(x_) | uint256(uint32(y_)) << 32 | altitude_ << 64 | battery_ << 80 | bandwidth_ << 96
            | uint256(uint32(block.timestamp)) << 128;
    }

    function altitude(Member m) internal pure returns (uint256) {
        return uint16(Member.unwrap(m) >> 64);
    }

    function battery(Member m) internal pure returns (uint256) {
        return uint16(Member.unwrap(m) >> 80);
    }

    function bandwidth(Member m) internal pure returns (uint256) {
        return uint32(Member.unwrap(m) >> 96);
    }

    function uavZone(Member m) internal pure returns (uint256) {
        return uint32(Member.unwrap(m) >> 184);
    }

    function place(Member m) internal pure returns (uint256) {
        return uint16(Member.unwrap(m) >> 216);
    }

    function index(Member m) internal pure returns (uint256) {
        return Member.unwrap(m) >> 232;
    }

    function withPlace(Member m, uint256 value) internal pure returns (Member) {
        return Member.wrap(Member.unwrap(m) & ~(uint256(0xffff) << 216) | value << 216);
    }

    /// @dev A UAV in another zone, written now.
    function withZone(Member m, uint256 zone, uint256 place_) internal view returns (Member) {
        uint256 kept = Member.unwrap(m) & ~(uint256(0xffffffffffff) << 184 | uint256(0xffffffff) << 128);
        return Member.wrap(kept | zone << 184 | place_ << 216 | uint256(uint32(block.timestamp)) << 128);
    }

    // Vehicle

    function vehicleInfo(int32 x_, int32 y_, uint256 payment_, uint256 zone) internal view returns (uint256) {
        return uint32(x_) | uint256(uint32(y_)) << 32 | payment_ << 64 | zone << 96
            | uint256(uint32(block.timestamp)) << 128;
    }

    function payment(Member m) internal pure returns (uint256) {
        return uint32(Member.unwrap(m) >> 64);
    }

    function vehicleZone(Member m) internal pure returns (uint256) {
        return uint32(Member.unwrap(m) >> 96);
    }

    function proposedUAV(Member m) internal pure returns (uint256) {
        return uint24(Member.unwrap(m) >> 184);
    }

    /// @dev 0 where the vehicle has no proposal to speak of.
    function proposedSession(Member m) internal pure returns (uint256) {
        return uint32(Member.unwrap(m) >> 208);
    }

    function proposedIndex(Member m) internal pure returns (uint256) {
        return Member.unwrap(m) >> 240;
    }

    function withProposal(Member m, uint256 uav, uint256 session, uint256 proposal) internal pure returns (Member) {
        return Member.wrap(uint184(Member.unwrap(m)) | uav << 184 | session << 208 | proposal << 240);
    }
}

library SessionLibrary {
    function number(Session s) internal pure returns (uint256) {
        return uint32(Session.unwrap(s));
    }

    /// @dev Zone and period in one word, to compare with `ZoneLibrary.key`.
    function key(Session s) internal pure returns (uint256) {
        return uint64(Session.unwrap(s) >> 32);
    }

    function count(Session s) internal pure returns (uint256) {
        return uint16(Session.unwrap(s) >> 96);
    }

    function decided(Session s) internal pure returns (uint256) {
        return uint16(Session.unwrap(s) >> 112);
    }

    function selected(Session s) internal pure returns (uint256) {
        return uint16(Session.unwrap(s) >> 128);
    }

    function committed(Session s) internal pure returns (uint256) {
        return uint32(Session.unwrap(s) >> 144);
    }

    function decidedBefore(Session s) internal pure returns (uint256) {
        return uint16(Session.unwrap(s) >> 176);
    }

    /// @dev The session after this one, without zone and proposals; one that never had a proposal serves again.
    function next(Session s) internal pure returns (Session) {
        return s.count() == 0 ? s : Session.wrap(uint32(s.number() + 1) | s.decided() << 176);
    }

    /// @dev A session without proposals, begun in a zone's period.
    function begun(Session s, uint256 key_) internal pure returns (Session) {
        return Session.wrap(s.number() | key_ << 32 | s.decidedBefore() << 176);
    }

    function withOneMore(Session s) internal pure returns (Session) {
        unchecked {
            return Session.wrap(Session.unwrap(s) + (1 << 96));
        }
    }

    /// @dev All proposals are decided.
    function withSelection(Session s, uint256 selected_, uint256 committed_) internal pure returns (Session) {
        uint256 kept = Session.unwrap(s) & ~(uint256(0xffffffffffffffff) << 112);
        return Session.wrap(kept | s.count() << 112 | selected_ << 128 | committed_ << 144);
    }

    function withOneLess(Session s, uint256 demand) internal pure returns (Session) {
        unchecked {
            return Session.wrap(Session.unwrap(s) - (1 << 128) - (demand << 144));
        }
    }
}

library ProposalLibrary {
    function pack(address vehicle_, uint256 demand_, uint256 score_) internal pure returns (Proposal) {
        return Proposal.wrap(uint256(uint160(vehicle_)) << 96 | score_ << 32 | demand_);
    }

    function demand(Proposal p) internal pure returns (uint256) {
        return uint32(Proposal.unwrap(p));
    }

    function score(Proposal p) internal pure returns (uint256) {
        return uint64(Proposal.unwrap(p) >> 32);
    }

    function vehicle(Proposal p) internal pure returns (address) {
        return address(uint160(Proposal.unwrap(p) >> 96));
    }
}

library ZoneLibrary {
    uint256 private constant ALLOCATING = 1 << 144;
    uint256 private constant MODEL = 1 << 145;

    /// @dev A zone in its first round of its first period.
    function opened() internal pure returns (Zone) {
        return Zone.wrap(1 << 32 | 1);
    }

    function period(Zone z) internal pure returns (uint256) {
        return uint32(Zone.unwrap(z));
    }

    /// @dev A zone's id and period in one word, to compare with `SessionLibrary.key`.
    function key(Zone z, uint256 zone) internal pure returns (uint256) {
        return zone | z.period() << 32;
    }

    function round(Zone z) internal pure returns (uint256) {
        return uint32(Zone.unwrap(z) >> 32);
    }

    /// @dev UAVs in the zone's list.
    function uavs(Zone z) internal pure returns (uint256) {
        return uint16(Zone.unwrap(z) >> 64);
    }

    function withOneMoreUAV(Zone z) internal pure returns (Zone) {
        unchecked {
            return Zone.wrap(Zone.unwrap(z) + (1 << 64));
        }
    }

    function withOneLessUAV(Zone z) internal pure returns (Zone) {
        unchecked {
            return Zone.wrap(Zone.unwrap(z) - (1 << 64));
        }
    }

    function cursor(Zone z) internal pure returns (uint256) {
        return uint16(Zone.unwrap(z) >> 80);
    }

    function selectedUAVs(Zone z) internal pure returns (uint256) {
        return uint16(Zone.unwrap(z) >> 96);
    }

    function selectedVehicles(Zone z) internal pure returns (uint256) {
        return uint32(Zone.unwrap(z) >> 112);
    }

    function allocating(Zone z) internal pure returns (bool) {
        return Zone.unwrap(z) & ALLOCATING != 0;
    }

    function hasModel(Zone z) internal pure returns (bool) {
        return Zone.unwrap(z) & MODEL != 0;
    }

    function withModel(Zone z) internal pure returns (Zone) {
        return Zone.wrap(Zone.unwrap(z) | MODEL);
    }

    /// @dev One UAV's number of selected vehicles changes.
    function withSelection(Zone z, uint256 before, uint256 after_) internal pure returns (Zone) {
        unchecked {
            uint256 word = Zone.unwrap(z) + (after_ << 112) - (before << 112);
            if (before != 0) word -= 1 << 96;
            if (after_ != 0) word += 1 << 96;
            return Zone.wrap(word);
        }
    }

    function withCursor(Zone z, uint256 cursor_) internal pure returns (Zone) {
        return Zone.wrap(Zone.unwrap(z) & ~(uint256(0xffff) << 80) | cursor_ << 80);
    }

    /// @dev Between two pieces of an allocation.
    function paused(Zone z, uint256 cursor_) internal pure returns (Zone) {
        return Zone.wrap(Zone.unwrap(z.withCursor(cursor_)) | ALLOCATING);
    }

    /// @dev The next round; selections and model stay.
    function nextRound(Zone z) internal pure returns (Zone) {
        return Zone.wrap((Zone.unwrap(z.withCursor(0)) & ~ALLOCATING) + (1 << 32));
    }

    /// @dev The next period: only the list of UAVs stays.
    function nextPeriod(Zone z) internal pure returns (Zone) {
        return Zone.wrap(uint80(Zone.unwrap(z) + (1 << 32) + 1));
    }
}
